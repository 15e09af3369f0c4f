"""The gait that trials have found, and the walk in open loop with it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from hexctl.adapt.space import GaitSpace
from hexctl.control.batch import SimTrial, run_sim_trial
from hexctl.control.trial_result import TrialResult
from hexctl.study.recovery import open_loop
from hexctl.study.recovery.episodes import RecoveryCase
from hexctl.study.recovery.methods import OpenLoopBest
from hexctl.study.recovery.open_loop import Rehearsal, rehearse
from tests.study.recovery.made_up import plan

PLACE = replace(plan().walked()[0][0], duration_s=7.0)


SHORT = replace(PLACE, duration_s=0.5).trial(
    RecoveryCase(gait="tripod", legs=(), failure="intact", at_s=2.5, heading_deg=0.0, method="nothing")
)


class Few(OpenLoopBest):
    """Tries two gaits."""

    def __init__(self) -> None:
        super().__init__(tries=2)


def case(*legs: int, method: str = f"{__name__}:Few") -> RecoveryCase:
    return RecoveryCase(
        gait="tripod",
        legs=legs,
        failure="locked" if legs else "intact",
        at_s=2.5,
        heading_deg=60.0,
        method=method,
    )


def test_each_walk_has_the_gait_with_which_a_trial_ended_nearest_its_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried: list[SimTrial] = []
    ends_m = iter([0.5, 0.1, 0.01, 0.3, 0.3, 0.2])
    statuses = iter(["ok", "ok", "fell", "ok", "no_progress", "ok"])

    def walk(trials: Sequence[SimTrial], _threads: int) -> list[TrialResult]:
        tried.extend(trials)
        return [_ended(next(ends_m), next(statuses)) for _ in trials]

    monkeypatch.setattr(open_loop, "run_sim_trials", walk)
    walks = [PLACE.trial(one) for one in (case(), case(2), case(2, 5))]
    intact, single, pair = rehearse(walks, tries=3)
    assert intact is None
    assert single == Rehearsal(gait=tried[1].plan.gait, trials=3), "not the one that fell"
    assert pair == Rehearsal(gait=tried[5].plan.gait, trials=3)
    assert len({one.plan.gait.slots for one in tried[:3]}) == 3
    assert {one.plan.gait.slots for one in tried[3:]} <= set(map(tuple, GaitSpace((2, 5)).slots.tolist()))
    assert {(one.plan.hold, one.plan.belief, one.plan.duration_s) for one in tried} == {("none", None, 10.0)}
    assert {event.at_s for one in tried for event in one.events} == {0.0}


def _ended(off_m: float, status: str) -> TrialResult:
    result = run_sim_trial(SHORT)
    assert result.deviation is not None
    return replace(result, status=status, deviation=replace(result.deviation, final=off_m))


@pytest.mark.slow
def test_after_the_failure_nothing_holds_the_line() -> None:
    intact, failed = PLACE.walk([case(), case(2)])
    held_intact, held = PLACE.walk([case(method="nothing"), case(2, method="nothing")])
    assert (intact.trials, failed.trials) == (0, 2)
    assert intact.signed_m == held_intact.signed_m
    assert failed.status == "ok"
    assert failed.alarms == ()
    assert np.isclose(failed.before_m_s, held.before_m_s), "until then it is the same walk"
    assert failed.final_m > 2 * held.final_m
    (alone,) = PLACE.walk([case(2)])
    assert repr(alone) == repr(failed)
