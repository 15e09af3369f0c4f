"""Gaits without two legs: codes for opposite ones, crawls with the body shifted for the others."""

import math
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from hexctl.control.assessment.crawl import CRAWL_SWING, gait_without, least_margin_m
from hexctl.control.assessment.static_stability import STAND_UP, slots_by_stability
from hexctl.control.batch import SimTrial, run_sim_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.walks.turning import check_plan
from hexctl.gait.foot_trajectory import StepPattern, gait_feet_body, in_stance, part_of_cycle
from hexctl.gait.gait import SWING_SHARE, Gait, Motion, make_gait
from hexctl.gait.posture import Posture
from hexctl.ik.support_polygon import centre_of_mass_body, support
from hexctl.robot.failure import Failure, FailureEvent
from tests.robots import ROBOT_NAMES, shipped

PAIRS = tuple(combinations(range(1, 7), 2))
OPPOSITE = ((1, 4), (2, 5), (3, 6))


def without(name: str, legs: tuple[int, ...], heading_rad: float = 0.0) -> Gait:
    robot = shipped(name)
    gait = replace(make_gait(robot, "tripod"), posture=Posture(body_raise=STAND_UP))
    return gait_without(robot, gait, heading_rad=heading_rad, legs=legs)


def standing_over_cycle(gait: Gait) -> np.ndarray:
    """Which feet are on the floor at 90 points of a cycle, (90, 6)."""
    pattern = StepPattern.of(shipped(), gait, plain=False)
    u = part_of_cycle((np.arange(90)[:, np.newaxis] + 0.5) / 90 + pattern.phases)
    standing = in_stance(u, pattern.swing_share)
    standing[:, [leg - 1 for leg in gait.posture.tucked_legs]] = False
    return np.asarray(standing)


def margin_m(name: str, gait: Gait, heading_rad: float) -> float:
    """Smallest static margin over the feet of the walk itself."""
    robot, standing = shipped(name), standing_over_cycle(gait)
    times_s = 10 / gait.pace_hz + (np.arange(90) + 0.5) / 90 / gait.pace_hz
    feet = gait_feet_body(robot, gait, Motion(heading_rad=heading_rad), times_s)[..., :2]
    centre = centre_of_mass_body(robot, robot.stance_angles_rad)[:2]
    return float(support(feet, standing, np.broadcast_to(centre, (90, 2))).margin_m.min())


def test_without_one_leg_it_is_the_most_stable_code() -> None:
    gait = without("ant", (2,))
    failure = Failure(leg=2, kind="limp")
    assert gait.slots == slots_by_stability(shipped(), heading_rad=0.0, failure=failure)[0]
    assert (gait.phases, gait.swing_share, gait.posture.shift) == (None, SWING_SHARE, (0.0, 0.0))


@pytest.mark.parametrize("name", ROBOT_NAMES)
@pytest.mark.parametrize("legs", OPPOSITE)
def test_opposite_legs_leave_a_code_that_carries(name: str, legs: tuple[int, int]) -> None:
    gait = without(name, legs)
    assert gait.phases is None
    assert gait.code(legs) is not None


@pytest.mark.parametrize("name", ROBOT_NAMES)
@pytest.mark.parametrize("heading_deg", [0, 90, 210])
def test_other_pairs_crawl_on_three_feet_or_more_and_safer_than_any_code(name: str, heading_deg: int) -> None:
    robot, heading_rad = shipped(name), math.radians(heading_deg)
    for legs in sorted(set(PAIRS) - set(OPPOSITE)):
        gait = without(name, legs, heading_rad)
        assert gait.swing_share == CRAWL_SWING
        assert gait.posture.tucked_legs == legs
        assert standing_over_cycle(gait).sum(axis=-1).min() == 3
        failures = [Failure(leg=leg, kind="limp") for leg in legs]
        best = slots_by_stability(robot, heading_rad=heading_rad, failure=failures)[0]
        code = Gait(
            slots=best,
            pace_hz=gait.pace_hz,
            amplitude=gait.amplitude,
            height=gait.height,
            posture=replace(gait.posture, shift=(0.0, 0.0)),
        )
        assert margin_m(name, gait, heading_rad) > margin_m(name, code, heading_rad) + 0.01
        check_plan(robot, TrialPlan(gait=gait, heading_rad=heading_rad))


@pytest.mark.parametrize("name", ROBOT_NAMES)
@pytest.mark.parametrize("first", range(1, 7))
def test_the_body_shifts_away_from_neighbours_that_are_lost(name: str, first: int) -> None:
    legs = (first, first % 6 + 1)
    lost = shipped(name).stance_feet_body[[leg - 1 for leg in legs], :2].mean(axis=0)
    assert np.dot(without(name, legs).posture.shift, lost) < 0


def test_slots_of_a_crawl_have_its_order_and_lost_legs_their_own() -> None:
    gait = without("ant", (2, 3))
    assert sorted(gait.slots) == [1, 2, 3, 4, 5, 6]
    assert (gait.slots[1], gait.slots[2]) == (2, 3)
    walking = [0, 3, 4, 5]
    assert gait.phases is not None
    by_phase = sorted(walking, key=lambda leg: gait.leg_phases[leg])
    assert by_phase == sorted(walking, key=lambda leg: gait.slots[leg])
    assert sorted(gait.phases[leg] for leg in walking) == [0.0, 0.25, 0.5, 0.75]


def test_tucked_legs_count_as_lost() -> None:
    robot = shipped()
    gait = replace(make_gait(robot, "tripod"), posture=Posture(body_raise=STAND_UP, tucked_legs=(2,)))
    assert gait_without(robot, gait, heading_rad=0.0, legs=(3,)) == without("ant", (2, 3))


def test_a_code_is_judged_at_the_stride_that_is_walked() -> None:
    """At twice the usual stride the code without legs 1 and 4 leans by more than `CODE_LEAN`."""
    robot = shipped()
    usual = make_gait(robot, "tripod")
    assert gait_without(robot, usual, heading_rad=0.0, legs=(1, 4)).phases is None
    gait = gait_without(robot, replace(usual, amplitude=0.22), heading_rad=0.0, legs=(1, 4))
    assert gait.phases is not None
    assert least_margin_m(robot, gait, heading_rad=0.0) > 0


def test_neighbours_that_are_missing_let_it_walk() -> None:
    """With the best of the 24 codes it walks at 0.4 of the ideal speed, limping from foot to foot."""
    robot, legs = shipped(), (4, 5)
    plan = TrialPlan(gait=without("ant", legs), duration_s=8.0, self_rotation="none", hold="line")
    events = [FailureEvent(at_s=0.02, leg=leg, failure=Failure(leg=leg, kind="missing")) for leg in legs]
    result = run_sim_trial(SimTrial(robot=robot, plan=plan, failure=None, events=events))
    assert result.status == "ok"
    assert result.distance_m is not None
    assert result.distance_m > 0.6 * result.ideal_distance_m
