"""Gaits that stand safest with the legs that are left, against another hull; and fast gaits."""

import math
from dataclasses import replace
from itertools import combinations, permutations
from typing import Any

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from hexctl import Failure, Gait, InputError, SimTrial, TrialPlan, make_gait
from hexctl.control.batch import run_sim_trial
from hexctl.control.planning.crawl import CRAWL_SWING, auto_gait, gait_without, least_margin_m, two_up
from hexctl.control.planning.leg_sets import CRAWLS, DOUBTFUL, NO_GAIT, WALKS, doubt, drag, leg_set
from hexctl.control.planning.static_stability import (
    STAND_UP,
    check_tucked,
    legs_that_stand,
    most_stable_slots,
    slots_by_stability,
    stable_slots_of,
    standing_margin_m,
    static_margins_m,
)
from hexctl.control.planning.top_speed import AMPLITUDES, COURSES_RAD, JointPath, fast_gaits
from hexctl.control.walks.turning import check_plan
from hexctl.control.walks.velocity_walk import OVERDRIVE
from hexctl.errors import UnusedError
from hexctl.gait.encoding import slots_from_code
from hexctl.gait.foot_trajectory import StepPattern, Swing, gait_feet_body, in_stance, part_of_cycle
from hexctl.gait.gait import SWING_SHARE, Motion
from hexctl.gait.posture import Posture
from hexctl.ik.support_polygon import centre_of_mass_body, support
from hexctl.robot.failure import each_failure
from hexctl.runs.run import run
from hexctl.runs.run_spec import RunSpec
from hexctl.runs.walk_plan import plan_walk
from tests.robots import ROBOT_NAMES, shipped

# Margins


def walked_margin_m(robot_name: str, slots: tuple[int, ...], heading_rad: float, failure: Failure) -> float:
    """Smallest margin over the feet of the walk itself, by scipy's convex hull."""
    robot = shipped(robot_name)
    gait: Gait = make_gait(robot, slots)
    times_s = (10 + np.arange(200) / 200) / gait.pace_hz
    feet = gait_feet_body(robot, gait, Motion(heading_rad=heading_rad), times_s)
    centre = centre_of_mass_body(robot, robot.stance_angles_rad)[:2]
    margins_m = []
    for row in feet:
        down = row[:, 2] < robot.stance_feet_body[:, 2] + 1e-9
        down[failure.leg - 1] = failure.kind == "locked"
        row[failure.leg - 1] = robot.stance_feet_body[failure.leg - 1]
        hull = ConvexHull(row[down, :2])
        margins_m.append(-(hull.equations[:, :2] @ centre + hull.equations[:, 2]).max())
    return float(min(margins_m))


@pytest.mark.parametrize(("robot_name", "kind"), [("ant", "locked"), ("phantomx", "limp")])
def test_the_margin_is_that_of_the_feet_of_the_walk(robot_name: str, kind: str) -> None:
    robot, failure = shipped(robot_name), Failure(leg=2, kind=kind)
    slots = [slots_from_code(code, (2,)) for code in (1, 33, 77, 120)]
    margins_m = static_margins_m(robot, slots, heading_rad=0.4, failure=failure)[:, 0]
    expected_m = [walked_margin_m(robot_name, one, 0.4, failure) for one in slots]
    np.testing.assert_allclose(margins_m, expected_m, atol=0.004)


@pytest.mark.parametrize("kind", ["locked", "missing"])
def test_no_gait_has_a_larger_margin(kind: str) -> None:
    robot, failure = shipped(), Failure(leg=4, kind=kind)
    chosen = most_stable_slots(robot, heading_rad=0.0, failure=failure)
    others = [(*rest[:3], 4, *rest[3:]) for rest in permutations((1, 2, 3, 5, 6))]
    margins_m = static_margins_m(robot, [chosen, *others], heading_rad=0.0, failure=failure)[:, 0]
    assert margins_m[0] == pytest.approx(margins_m.max(), abs=1e-6)
    assert margins_m[0] > np.median(margins_m) + 0.01


def test_it_is_chosen_for_the_direction_in_which_the_self_rotation_leaves_the_body() -> None:
    robot, failure = shipped(), Failure(leg=1)
    demo = make_gait(robot, "demo")
    rear = stable_slots_of(robot, TrialPlan(gait=demo, failures=(failure,)))
    as_it_is = stable_slots_of(robot, TrialPlan(gait=demo, failures=(failure,), self_rotation="none"))
    assert rear == most_stable_slots(
        robot, heading_rad=float(robot.leg_azimuths_rad[0]) - math.pi, failure=failure
    )
    assert as_it_is == most_stable_slots(robot, heading_rad=0.0, failure=failure)
    assert rear != as_it_is


def standing(failure: Failure | None = None, **posture: Any) -> TrialPlan:
    gait = replace(make_gait(shipped(), "demo"), posture=Posture(**posture))
    return TrialPlan(gait=gait, failures=each_failure(failure))


@pytest.mark.parametrize("robot_name", ["ant", "pexod"])
def test_the_margin_of_standing_is_that_of_the_hull_of_the_feet_that_stand(robot_name: str) -> None:
    robot = shipped(robot_name)
    for tucked, shift in (((), (0.0, 0.0)), ((2, 5), (0.03, -0.01)), ((1, 2, 3), (0.0, 0.0))):
        feet = [leg - 1 for leg in range(1, 7) if leg not in tucked]
        hull = ConvexHull(robot.stance_feet_body[feet, :2])
        over = centre_of_mass_body(robot, robot.stance_angles_rad)[:2] + np.array(shift) * robot.size_m
        expected_m = -(hull.equations[:, :2] @ over + hull.equations[:, 2]).max()
        plan = standing(tucked_legs=tucked, shift=shift)
        assert standing_margin_m(robot, plan) == pytest.approx(expected_m, abs=1e-9)


def test_legs_that_carry_nothing_do_not_stand() -> None:
    assert legs_that_stand(standing(tucked_legs=(2,))) == (1, 3, 4, 5, 6)
    for kind in ("limp", "missing", "weak", "stuck", "locked"):
        stands = legs_that_stand(standing(Failure(leg=4, kind=kind)))
        assert (4 in stands) == (kind not in ("limp", "missing")), kind
    assert 4 in legs_that_stand(standing(Failure(leg=4, kind="limp", joint="coxa")))
    raised = standing(Failure(leg=4), body_raise=0.01)
    assert 4 not in legs_that_stand(raised), "it hangs in its stance"


def test_legs_without_which_the_robot_cannot_stand_are_not_tucked() -> None:
    robot = shipped()
    for allowed in (standing(), standing(tucked_legs=(2, 5)), standing(tucked_legs=(1, 3, 5))):
        check_tucked(robot, allowed)
    check_tucked(robot, standing(tucked_legs=(1, 2), shift=(-0.05, -0.05)))
    for refused in (
        standing(tucked_legs=(1, 2)),
        standing(tucked_legs=(1, 2, 3)),
        standing(Failure(leg=6, kind="missing"), tucked_legs=(2, 4, 5)),
    ):
        with pytest.raises(InputError, match="tucked_legs"):
            check_tucked(robot, refused)


# Gaits without one or two legs


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
    standing = in_stance(u, pattern.swing)
    standing[:, [leg - 1 for leg in gait.posture.tucked_legs]] = False
    return np.asarray(standing)


def margin_m(name: str, gait: Gait, heading_rad: float) -> float:
    """Smallest static margin over the feet of the walk itself."""
    robot, standing = shipped(name), standing_over_cycle(gait)
    times_s = 10 / gait.pace_hz + (np.arange(90) + 0.5) / 90 / gait.pace_hz
    feet = gait_feet_body(robot, gait, Motion(heading_rad=heading_rad), times_s)[..., :2]
    centre = centre_of_mass_body(robot, robot.stance_angles_rad)[:2]
    return float(support(feet, standing, np.broadcast_to(centre, (90, 2))).margin_m.min())


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_opposite_legs_leave_a_code_that_carries_and_neighbours_shift_the_body_away(name: str) -> None:
    for legs in OPPOSITE:
        gait = without(name, legs)
        assert gait.phases is None
        assert gait.code(legs) is not None
    for first in range(1, 7):
        neighbours = (first, first % 6 + 1)
        lost = shipped(name).stance_feet_body[[leg - 1 for leg in neighbours], :2].mean(axis=0)
        assert np.dot(without(name, neighbours).posture.shift, lost) < 0


@pytest.mark.parametrize(("name", "heading_deg"), [("ant", 0), ("phantomx", 210), ("pexod", 90)])
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


def test_a_code_is_judged_at_the_stride_that_is_walked() -> None:
    """At twice the usual stride the code without legs 1 and 4 leans by more than `CODE_LEAN`."""
    robot = shipped()
    usual = make_gait(robot, "tripod")
    assert gait_without(robot, usual, heading_rad=0.0, legs=(1, 4)).phases is None
    gait = gait_without(robot, replace(usual, amplitude=0.22), heading_rad=0.0, legs=(1, 4))
    assert gait.phases is not None
    assert least_margin_m(robot, gait, heading_rad=0.0) > 0


# Legs that may be lost


@pytest.mark.parametrize(
    ("name", "legs", "verdict", "crawl"),
    [
        ("ant", (1,), WALKS, False),
        ("pexod", (3, 6), WALKS, False),
        ("pexod", (1, 2), DOUBTFUL, None),
        ("pexod", (1, 5), CRAWLS, True),
        ("pexod", (3, 4), CRAWLS, True),  # however little it leans
        ("ant", (1, 3, 5), NO_GAIT, None),
    ],
)
def test_which_legs_a_robot_can_lose(
    name: str, legs: tuple[int, ...], verdict: str, crawl: bool | None
) -> None:
    found = leg_set(shipped(name), make_gait(shipped(name), "demo"), legs)
    assert found.verdict == verdict
    assert crawl is None or found.crawl == crawl
    assert (doubt(found) is None) == (verdict in (WALKS, CRAWLS))


@pytest.mark.parametrize(("legs", "least", "most"), [((1, 5), 0.4, 1.1), ((2, 3), -0.5, 0.4)])
def test_the_simulation_agrees(legs: tuple[int, ...], least: float, most: float) -> None:
    """`pexod`, limp legs, straight ahead."""
    robot = shipped("pexod")
    first, second = (Failure(leg=leg, kind="limp") for leg in legs)
    plan = TrialPlan(gait=make_gait(robot, "demo"), failures=(first, second), duration_s=6.0, hold="line")
    plan = replace(plan, gait=auto_gait(robot, plan))
    result = run_sim_trial(SimTrial(robot=robot, plan=plan, failures=plan.failures))
    assert result.distance_m is not None
    assert least <= result.distance_m / result.ideal_distance_m <= most


@pytest.mark.parametrize(
    ("legs", "kind", "heading_deg", "drags"),
    [
        ((1, 2), "limp", 0, True),
        ((1, 2), "missing", 0, False),
        ((2, 3), "limp", 0, False),
        ((2, 3), "limp", 90, True),
    ],
)
def test_limp_neighbours_ahead_drag(legs: tuple[int, ...], kind: str, heading_deg: int, drags: bool) -> None:
    failures = [Failure(leg=leg, kind=kind) for leg in legs]
    note = drag(shipped("ant"), failures, math.radians(heading_deg))
    assert (note is not None) == drags


# Fast gaits: the pace of each is the one that the servos hold


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_the_joints_follow_the_fastest_gait_with_strokes_as_long_as_steering_makes_them(name: str) -> None:
    robot, gait = shipped(name), make_gait(shipped(name), "tripod")
    for fast in fast_gaits(robot, gait, heading_rad=0.0):
        pace_hz, most = OVERDRIVE * fast.pace_hz, 0.0
        for course_rad in COURSES_RAD:
            path = JointPath.of(robot, fast, Motion(heading_rad=course_rad))
            assert path is not None
            speeds = np.abs(pace_hz * path.changes_rad) / robot.joint_max_speed_rad_s
            most = max(most, speeds.max(), path.drive(pace_hz))
        assert most == pytest.approx(1.0, abs=2e-3)


def test_a_servo_that_cannot_hold_its_torque_has_no_pace() -> None:
    robot = shipped("phantomx")
    weak = replace(robot, joint_max_torque_nm=robot.dry_friction_nm)
    assert fast_gaits(weak, make_gait(weak, "tripod"), heading_rad=0.0) == ()


def test_two_of_five_legs_are_in_the_air_at_any_time() -> None:
    robot = shipped("ant")
    gait = two_up(
        robot, replace(make_gait(robot, "demo"), posture=Posture(tucked_legs=(2,))), heading_rad=0.0
    )
    u = part_of_cycle(np.linspace(0.001, 0.999, 97)[:, np.newaxis] + np.array(gait.leg_phases))
    standing = in_stance(u, Swing.of(np.array(gait.swing_share)))[:, [leg != 1 for leg in range(6)]]
    assert set(standing.sum(axis=1)) == {3}
    coded = replace(make_gait(robot, 1, failed_legs=(2,)), swing_share=0.4, posture=gait.posture)
    assert least_margin_m(robot, gait, heading_rad=0.0) > least_margin_m(robot, coded, heading_rad=0.0)


def test_a_fast_walk_keeps_the_order_of_a_gait_by_its_name_and_of_auto_only_with_six_legs() -> None:
    robot, failure = shipped("ant"), Failure(leg=5)
    spec = RunSpec(fast=True, gait="demo", failure=(failure,))
    coded = plan_walk(spec, robot).gait
    assert (coded.slots, coded.swing_share) == (make_gait(robot, "demo").slots, SWING_SHARE)
    fast = plan_walk(replace(spec, gait="auto"), robot).gait
    assert fast.swing_share == 2 / 5
    assert fast.pace_hz * fast.amplitude > coded.pace_hz * coded.amplitude
    slow = auto_gait(robot, plan_walk(replace(spec, fast=False, gait="auto"), robot))
    assert fast.posture == slow.posture
    assert round(fast.amplitude / slow.amplitude, 6) in AMPLITUDES


def test_gaits_are_ranked_by_the_speed_at_which_the_body_walks() -> None:
    robot = shipped("ant")
    gaits = fast_gaits(robot, make_gait(robot, "demo"), heading_rad=0.0, lost=(5,), reorder=True)
    speeds = [gait.amplitude * gait.pace_hz / (1 - gait.swing_share) for gait in gaits]
    assert speeds == sorted(speeds, reverse=True)
    assert len({gait.swing_share for gait in gaits}) == 2


def test_a_fast_walk_takes_no_pace_of_its_own() -> None:
    with pytest.raises(UnusedError, match="fast: got pace_hz too; allowed: one or the other"):
        RunSpec(fast=True, pace_hz=1.0).check()


@pytest.mark.slow
def test_a_fast_walk_on_five_legs_is_faster_and_clips_no_more() -> None:
    walk: dict[str, Any] = {"gait": "auto", "failure": "2:missing", "duration_s": 8.0, "record": False}
    usual, fast = run(**walk).trial, run(**walk, fast=True).trial
    assert (fast.distance_m or 0.0) > 1.4 * (usual.distance_m or math.inf)
    assert fast.clipped_ticks <= usual.clipped_ticks
