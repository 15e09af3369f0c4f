"""The layout that a recording opens with."""

from pathlib import Path
from typing import Any

import pytest
import rerun as rr

from hexctl.palette import BACKGROUND
from hexctl.recording import paths
from hexctl.recording.blueprint import make_blueprint
from hexctl.recording.sessions.session_figures import write_overview_file
from hexctl.recording.style import packed
from tests.recording.conftest import SESSION, Trial, write

#: What gives a view a background of its own, which follows the viewer's theme without, by class.
BACKGROUNDS = {"TimeSeries": "PlotBackground", "3D": "Background", "2D": "Background"}


def backgrounds(path: Path) -> list[tuple[str, int | None]]:
    """Class and background colour of each view that has one."""
    reader = rr.chunk.RrdReader(path)
    values: dict[str, dict[str, Any]] = {}
    for chunk in reader.stream(store=reader.blueprints()[0]).to_chunks():
        batch = chunk.to_record_batch()
        found = values.setdefault(str(chunk.entity_path), {})
        found |= {name: batch.column(name).to_pylist()[-1] for name in batch.schema.names if ":" in name}
    views = []
    for entity, found in values.items():
        (kind,) = found.get("ViewBlueprint:class_identifier", [None])
        if kind in BACKGROUNDS:
            part = BACKGROUNDS[kind]
            (color,) = values.get(f"{entity}/{part}", {}).get(f"{part}:color", [None])
            views.append((kind, color))
    return sorted(views)


@pytest.mark.parametrize("kind", ["trial", "overview"])
def test_scenes_are_dark_in_a_light_theme_too_and_plots_follow_it(
    kind: str, trial: Trial, tmp_path: Path
) -> None:
    path = tmp_path / f"{kind}.rrd"
    if kind == "trial":
        write(path, trial)
    else:
        write_overview_file(path, SESSION)
    found = backgrounds(path)
    assert {name for name, _ in found} == {"TimeSeries", "3D" if kind == "trial" else "2D"}
    assert {color for name, color in found if name != "TimeSeries"} == {packed(BACKGROUND)}
    assert {color for name, color in found if name == "TimeSeries"} == {None}


def test_a_recording_opens_with_the_time_of_the_walk_and_a_live_view_follows_it(
    trial: Trial, tmp_path: Path
) -> None:
    shown = {}
    for live in (False, True):
        path = tmp_path / f"{live}.rbl"
        layout = make_blueprint(trial.robot, trial.plan.heading_rad, trial.floor, watched=True, live=live)
        layout.save("hexctl", str(path))
        reader = rr.chunk.RrdReader(path)
        columns: dict[str, Any] = {}
        for chunk in reader.stream(store=reader.blueprints()[0]).to_chunks():
            batch = chunk.to_record_batch()
            columns |= {
                name: batch.column(name).to_pylist()[-1] for name in batch.schema.names if ":" in name
            }
        shown[live] = columns
    assert all(shown[live]["TimePanelBlueprint:timeline"] == [paths.WALK_TIMELINE] for live in shown)
    playing, following = (shown[live]["TimePanelBlueprint:play_state"] for live in (False, True))
    assert playing != following
