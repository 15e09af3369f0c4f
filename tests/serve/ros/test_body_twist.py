"""Velocities from poses, compared with SciPy's rotations."""

import numpy as np
from scipy.spatial.transform import Rotation

from hexctl.serve.ros.body_twist import BodyTwist


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
    assert not twist.of(1.0, np.zeros(3), one).any()  # a clock that began anew
