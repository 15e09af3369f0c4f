"""The overview recording of made-up sessions, read back."""

import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr

from hexctl.errors import InputError, RecordingError
from hexctl.palette import INVALID_COLOR, deviation_color
from hexctl.recording.sessions import session_figures as module
from hexctl.recording.sessions.session_figures import visible_m, write_overview_file
from hexctl.recording.sessions.session_overview import OverviewTrial, make_table
from hexctl.recording.viewer import viewer_binary
from tests.recording.conftest import SESSION, ReadBack, make_overview, make_trial


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("session") / "overview.rrd"
    write_overview_file(path, SESSION)
    return path


def rows(path: Path, entity: str, component: str) -> dict[int, Any]:
    """What an entity shows from which trial on."""
    found: dict[int, Any] = {}
    for chunk in rr.chunk.RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        if chunk.entity_path == entity and {"trial", component} <= set(batch.schema.names):
            found |= dict(
                zip(batch.column("trial").to_pylist(), batch.column(component).to_pylist(), strict=True)
            )
    return dict(sorted(found.items()))


def packed(color: tuple[int, int, int]) -> int:
    red, green, blue = color
    return red << 24 | green << 16 | blue << 8 | 0xFF


def test_each_trajectory_appears_with_its_trial_left_of_the_line_upward(written: Path) -> None:
    for trial in SESSION.trials:
        strips = rows(written, f"/above/trials/{trial.index:03d}", "LineStrips2D:strips")
        assert list(strips) == [trial.index]
        (strip,) = strips[trial.index]
        np.testing.assert_allclose(strip, trial.path_m * [1, -1], atol=1e-6)


def test_trajectories_are_coloured_by_deviation_and_invalid_ones_are_grey(written: Path) -> None:
    for trial in SESSION.trials:
        colors = rows(written, f"/above/trials/{trial.index:03d}", "LineStrips2D:colors")[trial.index]
        valid = trial.score_m is not None
        assert colors == [packed(deviation_color(trial.deviation_m, valid=valid) if valid else INVALID_COLOR)]


def test_the_best_so_far_changes_where_it_is_beaten(written: Path) -> None:
    assert list(rows(written, "/above/best", "LineStrips2D:strips")) == [1, 3]
    labels = rows(written, "/above/best/name", "Points2D:labels")
    assert labels == {
        1: ["best so far: trial 1, code 10, 80.0 cm right"],
        3: ["best so far: trial 3, code 30, 30.0 cm left"],
    }


def test_the_curve_has_scores_best_so_far_and_invalid_trials_above(written: Path) -> None:
    scores = rows(written, "/curve/score", "Scalars:scalars")
    best = rows(written, "/curve/best_so_far", "Scalars:scalars")
    invalid = rows(written, "/curve/invalid", "Scalars:scalars")
    assert scores == {1: [80.0], 3: [30.0], 4: [120.0]}
    assert best == {1: [80.0], 2: [80.0], 3: [30.0], 4: [30.0]}
    assert list(invalid) == [2]
    assert invalid[2][0] > 120.0
    assert rows(written, "/curve/targets/2", "Scalars:scalars") == {index: [2.5] for index in (1, 2, 3, 4)}


def test_the_baseline_is_a_level_line_from_before_the_first_trial(tmp_path: Path) -> None:
    walks = (
        replace(make_trial(0, 1.6), gait="demo"),
        replace(make_trial(0, 0.001), gait="tripod"),
        replace(make_trial(0, 0.5, valid=False), gait="wave"),
    )
    session = replace(SESSION, baseline=walks)
    path = tmp_path / "overview.rrd"
    write_overview_file(path, session)
    levels = {name: rows(path, f"/curve/baseline/{name}", "Scalars:scalars") for name in ("demo", "tripod")}
    assert levels["demo"] == {index: [160.0] for index in (0, 1, 2, 3, 4)}
    assert levels["tripod"] == {index: [0.1] for index in (0, 1, 2, 3, 4)}
    names = [ReadBack(path).values(f"/curve/baseline/{name}", "SeriesLines:names") for name in levels]
    assert names == [[["demo, without a search"]], [["tripod, without a search"]]]
    assert "/curve/baseline/wave" not in ReadBack(path).entities
    invalid = rows(path, "/curve/invalid", "Scalars:scalars")
    assert invalid[2][0] > 160.0, "a baseline that is worse than every trial is inside the picture"


def test_the_names_of_baseline_paths_that_end_together_stand_apart(tmp_path: Path) -> None:
    walks = [
        replace(make_trial(0, off_m), gait=name)
        for name, off_m in (("demo", 1.1), ("auto", 1.12), ("tripod", 1.11))
    ]
    path = tmp_path / "overview.rrd"
    session = replace(SESSION, baseline=tuple(walks))
    write_overview_file(path, session)
    read = ReadBack(path)
    places = [read.values(f"/above/baseline/{walk.gait}/name", "Points2D:positions")[0][0] for walk in walks]
    low, high = visible_m(session)
    across = sorted(y for _, y in places)
    assert min(np.diff(across)) > 0.04 * session.course_m
    assert all(low[0] < x < high[0] and -high[1] < y < -low[1] for x, y in places)


def test_line_bands_start_table_and_layout_are_in_the_file(written: Path) -> None:
    read = ReadBack(written)
    half_widths = [read.values(f"/above/bands/{band}", "LineStrips2D:radii")[0][0] for band in (1, 2)]
    assert half_widths == pytest.approx([0.1, 0.025])
    (line,) = read.values("/above/line_of_travel", "LineStrips2D:strips")[0]
    assert line == [[0.0, 0.0], [4.5, 0.0]]
    assert read.values("/above/start", "Points2D:positions") == [[[0.0, 0.0]]]
    assert read.values("/table", "TextDocument:text") == [[make_table(SESSION)]]
    assert len(read.blueprints) == 1
    assert read.blueprints[0].application_id == read.recordings[0].application_id


def test_a_trial_that_flew_away_does_not_shrink_the_picture() -> None:
    flown = make_overview(make_trial(1, 0.1), make_trial(2, 900.0, valid=False))
    low, high = visible_m(flown)
    assert (high - low < 2 * flown.course_m).all()


@pytest.mark.parametrize(
    "trials",
    [
        (make_trial(1, 0.4),),
        (make_trial(1, 0.0, valid=False), make_trial(2, 0.0, valid=False)),
        (
            OverviewTrial(
                index=1,
                code=1,
                slots=(1, 2, 3, 4, 5, 6),
                score_m=None,
                deviation_m=None,
                distance_m=None,
                status="aborted",
                path_m=np.zeros((0, 2)),
            ),
        ),
    ],
    ids=["one", "none valid", "never set out"],
)
def test_rerun_finds_nothing_wrong_with_any_session(
    trials: tuple[OverviewTrial, ...], tmp_path: Path
) -> None:
    path = tmp_path / "overview.rrd"
    write_overview_file(path, make_overview(*trials))
    done = subprocess.run(
        [str(viewer_binary()), "rrd", "verify", str(path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_a_later_overview_takes_the_place_of_an_earlier_one(tmp_path: Path) -> None:
    path = tmp_path / "overview.rrd"
    write_overview_file(path, make_overview(make_trial(1, 0.4)))
    with path.open("rb") as reader:
        write_overview_file(path, SESSION)
        assert len(ReadBack(path).recordings) == 1
        assert reader.read(3) == b"RRF"
    assert list(rows(path, "/curve/score", "Scalars:scalars")) == [1, 3, 4]
    assert list(tmp_path.iterdir()) == [path]


def test_what_fails_leaves_the_earlier_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise RecordingError("the disk is full")

    path = tmp_path / "overview.rrd"
    write_overview_file(path, SESSION)
    before = path.read_bytes()
    monkeypatch.setattr(module, "flush", refuse)
    with pytest.raises(RecordingError, match="full"):
        write_overview_file(path, SESSION)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_bad_places_and_empty_sessions_are_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot be written"):
        write_overview_file(tmp_path / "file" / "overview.rrd", SESSION)
    with pytest.raises(InputError, match="no trials"):
        write_overview_file(tmp_path / "overview.rrd", make_overview())
    (tmp_path / "overview.rrd").mkdir()
    with pytest.raises(RecordingError, match="cannot be written"):
        write_overview_file(tmp_path / "overview.rrd", SESSION)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "overview.rrd"]
