"""Which walk a session recommends."""

from typing import Any

import pytest

from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.sessions.walk_records import BaselineRecord, TrialRecord
from tests.adapt.walking import result_of


def stored(off_m: float, margin_m: float | None = None) -> dict[str, Any]:
    return {
        "score": abs(off_m),
        "outcome": result_of(off_m).to_dict(),
        "path_m": [],
        "recording": None,
        "margin_m": margin_m,
    }


def trial(index: int, off_m: float, margin_m: float | None = None) -> TrialRecord:
    return TrialRecord(index=index, code=index, slots=(1, 2, 3, 4, 5, 6), **stored(off_m, margin_m))


def walk(gait: str, off_m: float, margin_m: float | None = None) -> BaselineRecord:
    return BaselineRecord(gait=gait, code=None, slots=(1, 4, 1, 4, 1, 4), **stored(off_m, margin_m))


def recommended(
    *baseline: BaselineRecord, trials: tuple[TrialRecord, ...], uncertainty_m: float = 0.025, **spec: Any
) -> str | int | None:
    """Name of the gait of the baseline, or index of the trial, that a session recommends."""
    session = Session(
        name="s",
        spec=SessionSpec(failed_leg=5, uncertainty_m=uncertainty_m, **spec),
        created="2026-01-01",
        trials=list(trials),
        baseline=list(baseline),
    )
    best = session.best_walk
    return None if best is None else best.gait if isinstance(best, BaselineRecord) else best.index


@pytest.mark.parametrize("trial_m", [0.0, 0.06])
def test_a_gait_without_a_search_is_recommended_if_the_best_trial_is_not_resolved_from_it(
    trial_m: float,
) -> None:
    """The best trial, 6 cm off, was recommended though the tripod was 0.1 cm off: 5.9 cm are not resolved."""
    assert recommended(walk("tripod", 0.001), trials=(trial(1, trial_m), trial(2, 0.2))) == "tripod"


def test_a_trial_that_is_resolved_from_every_other_walk_is_recommended() -> None:
    assert recommended(walk("auto", 0.3), walk("demo", 0.5), trials=(trial(1, 0.2), trial(2, 0.01))) == 2
    assert recommended(walk("tripod", INVALID_SCORE), trials=(trial(1, 0.2),)) == 1


def test_of_gaits_that_need_no_search_the_one_with_the_largest_margin_is_recommended() -> None:
    near = (walk("auto", 0.03, 0.04), walk("demo", 0.001, -0.01), walk("tripod", 0.02, 0.02))
    assert recommended(*near, trials=(trial(1, 0.0, 0.1),)) == "auto"
    assert recommended(*near, trials=(trial(1, 0.0),), uncertainty_m=0.0001) == 1
    assert recommended(*near, trials=(trial(1, 0.1),), uncertainty_m=0.001) == "demo"
    unknown = (walk("auto", 0.03), walk("demo", 0.001))
    assert recommended(*unknown, trials=(trial(1, 0.0),)) == "demo", "without margins: the straightest"


def test_if_nothing_is_known_of_the_resolution_the_straightest_is_recommended() -> None:
    assert recommended(walk("tripod", 0.001), trials=(trial(1, 0.0),), uncertainty_m=0.0) == 1
    assert recommended(walk("tripod", 0.001), trials=(trial(1, 0.001),), uncertainty_m=0.0) == "tripod"


def test_before_the_first_trial_nothing_is_recommended() -> None:
    assert recommended(walk("tripod", 0.001), trials=()) is None
