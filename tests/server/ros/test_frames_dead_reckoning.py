"""Dead reckoning of a walk, by its legs alone and with an IMU."""

import numpy as np
import pytest

from hexctl.ik.leg_odometer import GAP_S
from hexctl.robot.failure import Failure
from hexctl.robot.rotations import about_z, product, wrapped_rad, yaw_rad
from hexctl.server.ros.frames import BodyPose, DeadReckoning
from hexctl.types import FloatArray, RobotState
from tests.driven import Command, Driven, driven
from tests.robots import shipped

LEAN = np.array([np.cos(0.05), np.sin(0.05), 0.0, 0.0])
START = BodyPose(np.array([1.0, 2.0, 0.1]), product(about_z(0.4), LEAN))

AHEAD: tuple[Command, ...] = ((1, 0, 0, 0), (8, 1, 0, 0))

#: Tick of such a walk by which a missing leg was noticed.
NOTICED = 250


@pytest.fixture
def walk() -> Driven:
    return driven("ant", ((1, 0, 0, 0), (4, 0.8, 0, 0.4)))


def state(walk: Driven, index: int, at_s: float | None = None) -> RobotState:
    return RobotState(walk.joints_rad[index], walk.times_s[index] if at_s is None else at_s, True)


def imu(walk: Driven, index: int) -> FloatArray:
    """What an IMU measures that began elsewhere, on a body that leans."""
    return product(about_z(walk.poses[index, 2] + 2.9), LEAN)


def away(walk: Driven) -> complex:
    """True way from the first to the last place, in the frame of the first."""
    moved = (walk.poses[-1] - walk.poses[0])[:2] @ np.array([1, 1j])
    return complex(moved * np.exp(-1j * walk.poses[0, 2]))


@pytest.mark.parametrize("with_imu", [True, False])
def test_a_walk_goes_on_from_where_it_began(walk: Driven, with_imu: bool) -> None:
    reckoning = DeadReckoning(shipped(), START)
    poses = [
        reckoning.update(state(walk, index), imu(walk, index) if with_imu else None)
        for index in range(len(walk.times_s))
    ]
    np.testing.assert_array_equal(poses[0].position_m, START.position_m)
    np.testing.assert_allclose(poses[0].quaternion, START.quaternion, atol=1e-12)
    moved = complex(*(poses[-1].position_m - START.position_m)[:2]) * np.exp(-0.4j)
    assert abs(moved - away(walk)) < 0.06 * abs(away(walk))
    turned = wrapped_rad(float(yaw_rad(poses[-1].quaternion)) - 0.4)
    true = walk.poses[-1, 2] - walk.poses[0, 2]
    assert turned == pytest.approx(true, abs=1e-9 if with_imu else 0.15 * abs(true))
    steps_m = np.linalg.norm(np.diff([one.position_m for one in poses], axis=0), axis=1)
    assert steps_m.max() < 0.012
    rise_m = [one.position_m[2] - START.position_m[2] for one in poses]
    np.testing.assert_allclose(rise_m, walk.height_m - walk.height_m[0], atol=0.004)


def test_without_a_start_it_is_at_the_origin_as_high_as_the_legs_say(walk: Driven) -> None:
    reckoning = DeadReckoning(shipped())
    for index in range(2):
        pose = reckoning.update(state(walk, index), None)
    assert pose.position_m == pytest.approx([0, 0, walk.height_m[1]], abs=0.003)
    np.testing.assert_allclose(pose.quaternion, [1, 0, 0, 0], atol=1e-3)


def test_roll_and_pitch_are_those_of_the_imu(walk: Driven) -> None:
    pose = DeadReckoning(shipped()).update(state(walk, 0), imu(walk, 0))
    np.testing.assert_allclose(pose.quaternion, LEAN, atol=1e-12)


@pytest.mark.parametrize("broken", ["angles", "orientation"])
def test_numbers_that_are_not_finite_leave_the_pose(walk: Driven, broken: str) -> None:
    reckoning = DeadReckoning(shipped(), START)
    before = reckoning.update(state(walk, 100), imu(walk, 100))
    angles, orientation = walk.joints_rad[101].copy(), imu(walk, 101)
    (angles if broken == "angles" else orientation)[:] = np.nan
    reckoning.update(RobotState(angles, walk.times_s[101], True), orientation)
    after = reckoning.update(state(walk, 102), imu(walk, 102))
    assert np.linalg.norm(after.position_m - before.position_m) < 0.01
    np.testing.assert_allclose(after.quaternion, before.quaternion, atol=0.02)


def test_a_gap_is_no_step_of_the_legs_but_a_turn_of_the_imu(walk: Driven) -> None:
    reckoning = DeadReckoning(shipped(), START)
    before = reckoning.update(state(walk, 100), imu(walk, 100))
    after = reckoning.update(state(walk, 120, walk.times_s[100] + GAP_S), imu(walk, 120))
    np.testing.assert_array_equal(after.position_m[:2], before.position_m[:2])
    turned = float(yaw_rad(after.quaternion) - yaw_rad(before.quaternion))
    assert turned == pytest.approx(walk.poses[120, 2] - walk.poses[100, 2], abs=1e-9)


def test_a_state_that_comes_twice_is_taken_once(walk: Driven) -> None:
    reckoning = DeadReckoning(shipped(), START)
    for index in (100, 101):
        pose = reckoning.update(state(walk, index), None)
    again = reckoning.update(state(walk, 101), None)
    np.testing.assert_array_equal(again.numbers, pose.numbers)


def test_half_a_pose_is_none() -> None:
    position, quaternion = START.position_m, START.quaternion
    for half in ((None, quaternion), (position, None), (position * np.nan, quaternion)):
        given = RobotState(
            np.zeros(18), 0.0, True, base_position_world=half[0], base_quaternion_world=half[1]
        )
        assert BodyPose.of(given) is None


@pytest.mark.slow
def test_a_missing_leg_is_noticed_by_poses_from_outside_which_move_nothing() -> None:
    walk = driven("pexod", AHEAD, failure=Failure(leg=2, kind="missing"), told=False)
    alone, seen = DeadReckoning(shipped("pexod"), START), DeadReckoning(shipped("pexod"), START)
    ways = []
    for index in range(len(walk.times_s)):
        ways.append([one.update(state(walk, index), None).position_m for one in (alone, seen)])
        x_m, y_m, yaw = walk.poses[index].tolist()
        seen.see(walk.times_s[index], BodyPose(np.array([x_m, y_m, 0.1]), about_z(yaw)))
    steps_m = np.linalg.norm(np.diff(ways, axis=0), axis=2)
    assert steps_m.max() < 0.012
    true_m = np.hypot(*(walk.poses[-1] - walk.poses[NOTICED])[:2])
    alone_m, seen_m = np.linalg.norm(np.array(ways[-1]) - np.array(ways[NOTICED]), axis=1)
    assert abs(alone_m - true_m) > 0.7 * true_m
    assert abs(seen_m - true_m) < 0.35 * true_m
