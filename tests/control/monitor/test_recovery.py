"""What policies decide."""

import pytest

from hexctl.control.assessment import crawl
from hexctl.control.monitor.recovery import GlideToStableGait, Response, StopWalking, WalkOn
from hexctl.control.plan import TrialPlan
from hexctl.gait.gait import make_gait
from hexctl.gait.posture import Posture
from hexctl.robot.failure import Failure
from tests.robots import ROBOT_NAMES, shipped


def _plan(name: str = "ant") -> TrialPlan:
    return TrialPlan(gait=make_gait(shipped(name), "tripod"), hold="line")


def test_nothing_and_a_stop() -> None:
    failures = (Failure(leg=2),)
    assert WalkOn().respond(shipped(), _plan(), 0.0, failures) == Response()
    assert StopWalking().respond(shipped(), _plan(), 0.0, failures) == Response(stop=True)


@pytest.mark.parametrize("name", ROBOT_NAMES)
@pytest.mark.parametrize("legs", [(1,), (5,), (2, 5)])
def test_failed_legs_are_tucked_and_the_others_walk_a_gait_of_their_own(
    name: str, legs: tuple[int, ...]
) -> None:
    policy, plan = GlideToStableGait(), _plan(name)
    response = policy.respond(shipped(name), plan, 0.0, [Failure(leg=leg) for leg in legs])
    assert response.gait is not None
    assert response.gait.posture.tucked_legs == legs
    assert response.gait.posture.body_raise > 0
    assert sorted(response.gait.slots) == [1, 2, 3, 4, 5, 6]
    assert response.gait.pace_hz == plan.gait.pace_hz


def test_once_all_legs_are_whole_the_walk_is_that_of_the_plan() -> None:
    plan = _plan()
    assert GlideToStableGait().respond(shipped(), plan, 0.0, ()) == Response(gait=plan.gait)


def test_the_posture_of_the_plan_is_kept() -> None:
    plan = _plan()
    gait = make_gait(shipped(), "wave")
    raised = Posture(body_raise=0.03, tucked_legs=(6,))
    plan = TrialPlan(
        gait=type(gait)(slots=gait.slots, pace_hz=0.5, amplitude=0.1, height=0.05, posture=raised)
    )
    response = GlideToStableGait().respond(shipped(), plan, 0.0, [Failure(leg=2)])
    assert response.gait is not None
    assert response.gait.posture.body_raise == 0.03
    assert response.gait.posture.tucked_legs == (2, 6)
    assert response.gait.pace_hz == 0.5


def test_gaits_are_ready_before_the_walk() -> None:
    """A response within a tick only looks them up."""
    policy, plan = GlideToStableGait(), _plan()
    policy.prepare(shipped(), plan, 0.5)
    known = crawl._gait_without.cache_info().misses
    for leg in range(1, 7):
        policy.respond(shipped(), plan, 0.5, [Failure(leg=leg, kind="locked")])
        policy.respond(shipped(), plan, 0.5, [Failure(leg=leg), Failure(leg=leg % 6 + 1)])
    assert crawl._gait_without.cache_info().misses == known


def test_without_three_legs_it_stops() -> None:
    failures = [Failure(leg=leg, kind="limp") for leg in (1, 3, 5)]
    assert GlideToStableGait().respond(shipped(), _plan(), 0.0, failures) == Response(stop=True)
