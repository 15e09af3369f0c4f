"""The overview recording of made-up sessions, read back."""

import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.errors import InputError, RecordingError
from hexctl.recording import rrd
from hexctl.recording.sessions.session_figures import visible_m, write_overview_file
from hexctl.recording.sessions.session_overview import Overview, OverviewTrial, drawable
from hexctl.recording.viewer import viewer_binary
from tests.recording.conftest import ReadBack


def make_trial(index: int, deviation_m: float, *, valid: bool = True) -> OverviewTrial:
    return OverviewTrial(
        index=index,
        code=10 * index,
        slots=(1, 2, 3, 4, 5, 6),
        score_m=abs(deviation_m) if valid else None,
        deviation_m=deviation_m,
        distance_m=4.0,
        status="ok" if valid else "fell",
        path_m=np.linspace([0.0, 0.0], [4.0, deviation_m], 20),
    )


def make_overview(*trials: OverviewTrial) -> Overview:
    return Overview(
        title="a session", facts=("leg 5",), objective="deviation at the end", course_m=4.5, trials=trials
    )


SESSION = make_overview(
    make_trial(1, -0.8), make_trial(2, 0.0, valid=False), make_trial(3, 0.3), make_trial(4, 1.2)
)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("session") / "overview.rrd"
    write_overview_file(path, SESSION)
    return path


def rows(path: Path, entity: str, component: str) -> dict[int, Any]:
    """What an entity shows from which trial on."""
    return {
        trial: value for trial, value in ReadBack(path).rows(entity, component, "trial") if trial is not None
    }


def test_the_curve_has_scores_best_so_far_and_invalid_trials_above(written: Path) -> None:
    scores = rows(written, "/curve/score", "Scalars:scalars")
    best = rows(written, "/curve/best_so_far", "Scalars:scalars")
    invalid = rows(written, "/curve/invalid", "Scalars:scalars")
    assert scores == {1: [80.0], 3: [30.0], 4: [120.0]}
    assert best == {1: [80.0], 2: [80.0], 3: [30.0], 4: [30.0]}
    assert list(invalid) == [2]
    (strip,) = rows(written, "/above/trials/003", "LineStrips2D:strips")[3]
    np.testing.assert_allclose(strip, SESSION.trials[2].path_m * [1, -1], atol=1e-6)
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
    assert "/curve/baseline/wave" not in ReadBack(path).entities
    invalid = rows(path, "/curve/invalid", "Scalars:scalars")
    assert invalid[2][0] > 160.0, "a baseline that is worse than every trial is inside the picture"


def test_rerun_finds_nothing_wrong_with_any_session(tmp_path: Path) -> None:
    none = replace(
        make_trial(1, 0.0, valid=False), deviation_m=None, distance_m=None, path_m=np.zeros((0, 2))
    )
    flown = make_overview(make_trial(1, 0.1), make_trial(2, 900.0, valid=False))
    short = replace(SESSION, course_m=0.1)
    for number, session in enumerate((make_overview(none), flown, short)):
        path = tmp_path / f"{number}.rrd"
        write_overview_file(path, session)
        command = [str(viewer_binary()), "rrd", "verify", str(path)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    low, high = visible_m(flown)
    assert (high - low < 2 * flown.course_m).all(), "what flew away does not shrink the picture"


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
    monkeypatch.setattr(rrd, "flush", refuse)
    with pytest.raises(RecordingError, match="full"):
        write_overview_file(path, SESSION)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(InputError):
        write_overview_file(path / "below" / "overview.rrd", SESSION)
    with pytest.raises(InputError):
        write_overview_file(tmp_path / "empty.rrd", make_overview())
    assert list(tmp_path.iterdir()) == [path]


def test_points_that_cannot_be_drawn_are_left_out() -> None:
    path = np.array([[0.0, 0.0], [0.1, 0.0], [np.nan, 0.0], [np.inf, 1.0], [0.0, -1e9]])
    np.testing.assert_array_equal(drawable(path), path[:2])
    assert drawable(np.zeros((0, 2))).shape == (0, 2)
