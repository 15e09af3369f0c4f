"""Fast gaits: the pace of each is the one that the servos hold, and a walk at it clips no commands."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hexctl.control.assessment.crawl import auto_gait, least_margin_m, two_up
from hexctl.control.assessment.top_speed import AMPLITUDES, COURSES_RAD, JointPath, fast_gaits
from hexctl.control.walks.velocity_walk import OVERDRIVE
from hexctl.errors import UnusedError
from hexctl.gait.foot_trajectory import Swing, in_stance, part_of_cycle
from hexctl.gait.gait import SWING_SHARE, Motion, make_gait
from hexctl.gait.posture import Posture
from hexctl.robot.failure import Failure
from hexctl.runs.run import run
from hexctl.runs.run_spec import RunSpec, plan_of
from tests.robots import ROBOT_NAMES, shipped


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
    coded = plan_of(spec, robot).gait
    assert (coded.slots, coded.swing_share) == (make_gait(robot, "demo").slots, SWING_SHARE)
    fast = plan_of(replace(spec, gait="auto"), robot).gait
    assert fast.swing_share == 2 / 5
    assert fast.pace_hz * fast.amplitude > coded.pace_hz * coded.amplitude
    slow = auto_gait(robot, plan_of(replace(spec, fast=False, gait="auto"), robot))
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
