"""The steps of a search in an overview, read back."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.palette import deviation_color
from hexctl.recording.sessions.belief_figure import FAR_M, HEIGHT, height
from hexctl.recording.sessions.session_figures import write_overview_file
from hexctl.recording.sessions.session_overview import GaitBeliefs, SearchStep
from hexctl.recording.style import packed
from tests.recording.conftest import SESSION, ReadBack, make_trial

GAITS = 120


def beliefs_of(trials: int) -> GaitBeliefs:
    signed_m = np.linspace(-1.0, 1.0, GAITS) / (trials + 1)
    return GaitBeliefs(signed_m=signed_m, low_m=signed_m - 0.2, high_m=signed_m + 0.3)


STEPS = tuple(
    SearchStep(trials=done, note=f"after {done}", next_code=code, beliefs=beliefs_of(done))
    for done, code in enumerate((10, 20, 30, 40, None))
)

BELIEVING = replace(SESSION, steps=STEPS, baseline=(replace(make_trial(0, 0.4), gait="demo", code=77),))


@pytest.fixture(scope="module")
def read(tmp_path_factory: pytest.TempPathFactory) -> ReadBack:
    path = tmp_path_factory.mktemp("beliefs") / "overview.rrd"
    write_overview_file(path, BELIEVING)
    return ReadBack(path)


def by_trial(read: ReadBack, entity: str, component: str) -> dict[int, Any]:
    """What an entity shows from which number of trials on."""
    times = np.round(read.times_s(entity, component, "trial") * 1e9).astype(int)
    return dict(zip(times.tolist(), read.values(entity, component), strict=True))


def test_the_scale_is_even_on_both_sides_and_ends_where_it_is_far() -> None:
    assert height(0.0) == 0
    assert height(0.3) == -height(-0.3)
    assert height(0.3) < height(0.1) < 0, "left of the line is upward"
    assert height(1e6) == height(FAR_M) == -HEIGHT


def test_each_gait_has_its_interval_after_each_trial(read: ReadBack) -> None:
    strips = by_trial(read, "/belief/intervals", "LineStrips2D:strips")
    colors = by_trial(read, "/belief/intervals", "LineStrips2D:colors")
    assert list(strips) == [0, 1, 2, 3, 4]
    for step in STEPS:
        assert step.beliefs is not None
        drawn = np.array(strips[step.trials])
        assert drawn.shape == (GAITS, 2, 2)
        np.testing.assert_allclose(drawn[:, 0, 1], height(step.beliefs.low_m), atol=1e-5)
        np.testing.assert_allclose(drawn[:, 1, 1], height(step.beliefs.high_m), atol=1e-5)
        np.testing.assert_array_equal(drawn[:, 0, 0], np.arange(1, GAITS + 1))
        assert colors[step.trials] == [
            packed(deviation_color(off_m, valid=True)) for off_m in step.beliefs.signed_m.tolist()
        ]


def test_the_next_gait_is_named_until_there_is_none(read: ReadBack) -> None:
    names = by_trial(read, "/belief/next/name", "Points2D:labels")
    assert names == {
        0: ["next: gait 10"],
        1: ["next: gait 20"],
        2: ["next: gait 30"],
        3: ["next: gait 40"],
        4: [],
    }
    strips = by_trial(read, "/belief/next", "LineStrips2D:strips")
    assert [len(strips[trials]) for trials in range(5)] == [1, 1, 1, 1, 0]


def test_trials_show_where_they_ended_once_they_are_walked(read: ReadBack) -> None:
    walked = by_trial(read, "/belief/walked", "Points2D:positions")
    assert list(walked) == [1, 2, 3, 4]
    np.testing.assert_allclose(
        walked[4],
        [[10 * trial.index, float(height(trial.deviation_m or 0.0))] for trial in SESSION.trials],
        atol=1e-5,
    )
    assert len(walked[2]) == 2
    demo = read.values("/belief/not_told/demo", "Points2D:positions")
    np.testing.assert_allclose(demo, [[[77.0, float(height(0.4))]]], atol=1e-5)


def test_beliefs_do_not_stay_where_there_are_none_any_more(tmp_path: Path) -> None:
    path = tmp_path / "overview.rrd"
    few = (*STEPS[:3], *(replace(step, beliefs=None) for step in STEPS[3:]))
    write_overview_file(path, replace(SESSION, steps=few))
    read = ReadBack(path)
    shown = {
        "intervals": by_trial(read, "/belief/intervals", "LineStrips2D:strips"),
        "expected": by_trial(read, "/belief/expected", "Points2D:positions"),
        "walked": by_trial(read, "/belief/walked", "Points2D:positions"),
        "next": by_trial(read, "/belief/next", "LineStrips2D:strips"),
        "name": by_trial(read, "/belief/next/name", "Points2D:positions"),
    }
    assert {name: (max(rows), rows[3]) for name, rows in shown.items()} == dict.fromkeys(shown, (3, []))
    assert all(rows[2] for rows in shown.values())


def test_notes_change_with_the_trials(read: ReadBack) -> None:
    assert by_trial(read, "/steps", "TextDocument:text") == {done: [f"after {done}"] for done in range(5)}


def test_a_search_without_beliefs_has_notes_and_no_figure(tmp_path: Path) -> None:
    path = tmp_path / "overview.rrd"
    write_overview_file(path, replace(SESSION, steps=tuple(replace(step, beliefs=None) for step in STEPS)))
    entities = ReadBack(path).entities
    assert "/steps" in entities
    assert not [entity for entity in entities if entity.startswith("/belief")]
