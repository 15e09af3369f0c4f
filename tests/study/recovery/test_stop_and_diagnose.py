"""Stop, diagnose, go: from an alarm over the standing test to a walk for the legs that are left."""

from collections.abc import Sequence
from dataclasses import replace

import pytest

from hexctl.control.batch import run_sim_trials
from hexctl.control.diagnosis.standing_test import Probe
from hexctl.control.monitor.recovery import GlideToStableGait, StopWalking
from hexctl.control.preparation import WalkStart
from hexctl.study.recovery.episodes import Episode, RecoveryCase
from hexctl.study.recovery.methods import method_of
from hexctl.study.recovery.stop_and_diagnose import EachAlone, StopAndDiagnoseWalk
from hexctl.types import FloatArray, RobotState
from tests.study.recovery.made_up import plan

PLACE = replace(plan().walked()[0][0], duration_s=24.0)

#: The soft stop, the standing test, and the rest before it take longer than this.
LEAST_S = 13.0


def case(*legs: int, failure: str = "limp") -> RecoveryCase:
    return RecoveryCase(
        gait="tripod",
        legs=legs,
        failure=failure if legs else "intact",
        at_s=2.5,
        heading_deg=0.0,
        method="stop-diagnose",
    )


@pytest.fixture(scope="module")
def episodes() -> list[Episode]:
    return PLACE.walk([case(), case(2), case(5, failure="locked"), case(4, failure="missing")])


@pytest.mark.slow
def test_the_standing_test_says_what_failed_and_when_it_is_known(episodes: Sequence[Episode]) -> None:
    intact, *failed = episodes
    assert intact.alarms == ()
    for one in failed:
        (alarm,) = one.alarms
        assert (one.right_leg, one.right_kind) == (True, True)
        assert alarm.evidence == "standing test"
        assert LEAST_S < one.delay_s < LEAST_S + 4


def test_it_goes_on_along_the_line_after_it_has_stood(episodes: Sequence[Episode]) -> None:
    intact, *failed = episodes
    for one in failed:
        assert one.ended
        assert one.final_m < 0.02
        assert 0 < one.after_m_s < 0.5 * intact.after_m_s, "it stood for most of that time"
        assert one.last_m_s > one.after_m_s


@pytest.mark.slow
def test_it_is_told_nothing_of_what_is_to_come(episodes: Sequence[Episode]) -> None:
    trial = PLACE.trial(case(2))
    method = method_of("stop-diagnose")
    (result,) = run_sim_trials([trial], 1, lambda start: method.controller(_checked(start), [()]), apart=True)
    assert repr(Episode.of(case(2), trial, result)) == repr(episodes[1])


class Watched(StopAndDiagnoseWalk):
    """Keeps the walks and the counts of limited steps."""

    def __init__(self, start: WalkStart) -> None:
        super().__init__(start, GlideToStableGait(), probes=[Probe("lift", (leg,)) for leg in (2, 5)])
        self.walk.walk.limited_steps = 5  # as of a line that is far away
        self.walks, self.counts = [self.walk], list[int]()

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        targets_rad = super().targets_rad(step, state)
        if self.walk is not self.walks[-1]:
            self.walks.append(self.walk)
        self.counts.append(int(self.limited_steps))
        return targets_rad


@pytest.mark.slow
def test_the_walk_after_the_test_knows_what_was_found_and_counts_on() -> None:
    made: list[Watched] = []

    def watched(start: WalkStart) -> Watched:
        made.append(Watched(start))
        return made[-1]

    def make(start: WalkStart) -> EachAlone:
        return EachAlone(start, watched)

    place = replace(PLACE, duration_s=20.0)
    run_sim_trials([place.trial(case(2))], 1, make, apart=True)
    before, after = made[0].walks
    assert [one.suspicion.leg for one in before.noticed[0]] == [2]
    assert after.noticed[0] == []
    assert made[0].counts[-1] == 5 + after.limited_steps
    assert before.limited_steps == 5


def test_a_policy_that_stops_ends_the_walk_after_the_test() -> None:
    def make(start: WalkStart) -> EachAlone:
        lifts = (Probe("lift", (2,)), Probe("lift", (5,)))
        return EachAlone(start, lambda one: StopAndDiagnoseWalk(one, StopWalking(), probes=lifts))

    (result,) = run_sim_trials([PLACE.trial(case(2))], 1, make, apart=True)
    assert (result.status, result.stopped) == ("aborted", "leg 2 limp")
    assert result.duration_s < 12


def _checked(start: WalkStart) -> WalkStart:
    assert all(plan.belief is None for plan in start.plans)
    return start
