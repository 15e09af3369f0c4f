"""Velocities from poses, compared with SciPy's rotations."""

import numpy as np
from scipy.spatial.transform import Rotation

from hexctl.robot.body_twist import BodyTwist, body_twists


def quaternion(rotation: Rotation) -> np.ndarray:
    """Components w, x, y, z."""
    return np.array(rotation.as_quat()[[3, 0, 1, 2]])


def test_a_steady_motion_is_seen_in_the_frame_of_the_body() -> None:
    velocity, turn = np.array([0.2, -0.1, 0.05]), np.array([0.1, -0.2, 0.8])
    first = Rotation.from_euler("zyx", [2.0, 0.1, -0.2])
    twist, position, period_s = BodyTwist(), np.array([1.0, 2.0, 0.1]), 0.02
    for index in range(20):
        now = first * Rotation.from_rotvec(turn * index * period_s)
        found = twist.of(index * period_s, position, quaternion(now))
        position = position + now.apply(velocity) * period_s
    np.testing.assert_allclose(found[3:], turn, atol=1e-12)
    # Averaged over 0.1 s, in which the body turns on by 0.08 rad.
    np.testing.assert_allclose(found[:3], velocity, atol=0.02)


def test_a_sign_of_the_quaternion_is_no_turn() -> None:
    twist = BodyTwist()
    pose = quaternion(Rotation.from_euler("z", 1.0))
    twist.of(0.0, np.zeros(3), pose)
    np.testing.assert_allclose(twist.of(0.02, np.zeros(3), -pose), np.zeros(6), atol=1e-7)


def test_the_first_pose_and_one_after_a_gap_have_no_velocity() -> None:
    twist = BodyTwist()
    one = np.array([1.0, 0.0, 0.0, 0.0])
    assert not twist.of(0.0, np.zeros(3), one).any()
    assert not twist.of(9.0, np.ones(3), one).any()
    assert twist.of(9.02, 1.01 * np.ones(3), one).any()
    assert not twist.of(1.0, np.zeros(3), one).any()  # a clock that was set back


def test_a_recorded_body_that_turns_about_its_vertical_while_it_moves_ahead_in_the_world() -> None:
    times_s = np.linspace(0, 0.98, 50)
    turn = np.column_stack([np.cos(times_s / 4), np.zeros(50), np.zeros(50), np.sin(times_s / 4)])
    turn[20:] *= -1  # the same orientations
    ahead = np.column_stack([0.2 * times_s, np.zeros(50), np.zeros(50)])
    linear, angular = body_twists(times_s, ahead, turn)
    np.testing.assert_allclose(angular, np.tile([0, 0, 0.5], (50, 1)), atol=1e-3)
    expected = 0.2 * np.column_stack([np.cos(times_s / 2), -np.sin(times_s / 2), np.zeros(50)])
    np.testing.assert_allclose(linear, expected, atol=1e-3)


def test_poses_as_they_come_have_the_velocities_of_their_recording() -> None:
    times_s = np.linspace(0, 0.78, 40)
    places = np.column_stack([0.1 * times_s, 0.05 * np.sin(times_s), np.zeros(40)])
    turns = np.array([quaternion(Rotation.from_euler("z", 0.4 * time_s)) for time_s in times_s])
    linear, angular = body_twists(times_s, places, turns)
    twist = BodyTwist()
    came = np.array([twist.of(*pose) for pose in zip(times_s, places, turns, strict=True)])
    np.testing.assert_allclose(came[10:, :3], linear[10:], atol=5e-3)
    np.testing.assert_allclose(came[10:, 3:], angular[10:], atol=1e-4)
