"""Orientation quaternions against MuJoCo and SciPy, and velocities from poses."""

import math

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hexctl.robot.body_twist import BodyTwist
from hexctl.robot.rotations import (
    about_z,
    cos_tilt,
    inverse,
    matrix_of,
    product,
    quaternion_about,
    quaternion_of_euler,
    turned,
    wrapped_rad,
    wxyz,
    xyzw,
    yaw_rad,
)

angles = st.floats(-math.pi, math.pi)


def _quaternion(yaw: float, pitch: float, roll: float) -> np.ndarray:
    quaternion = np.zeros(4)
    mujoco.mju_euler2Quat(quaternion, np.array([yaw, pitch, roll]), "zyx")
    return quaternion


@given(yaw=angles, pitch=st.floats(-1.5, 1.5), roll=angles)
def test_yaw_and_tilt_of_a_turned_body(yaw: float, pitch: float, roll: float) -> None:
    quaternion = _quaternion(yaw, pitch, roll)
    assert math.remainder(float(yaw_rad(quaternion)) - yaw, math.tau) == pytest.approx(0, abs=1e-9)
    up = np.zeros(3)
    mujoco.mju_rotVecQuat(up, np.array([0.0, 0.0, 1.0]), quaternion)
    assert float(cos_tilt(float(quaternion[1]), float(quaternion[2]))) == pytest.approx(up[2], abs=1e-12)


def test_the_order_of_scipy_is_the_same_turn() -> None:
    quaternions = np.array([_quaternion(0.3, 0.1, 0.2), _quaternion(-2.0, 0.4, 1.0)])
    vector = np.array([0.3, -0.2, 0.9])
    for quaternion, other in zip(quaternions, xyzw(quaternions), strict=True):
        np.testing.assert_allclose(Rotation.from_quat(other).apply(vector), turned(quaternion, vector))
    np.testing.assert_array_equal(wxyz(xyzw(quaternions)), quaternions)


@given(roll=angles, pitch=angles, yaw=angles)
def test_euler_angles_axes_and_matrices_are_those_of_scipy(roll: float, pitch: float, yaw: float) -> None:
    fixed = Rotation.from_euler("xyz", [roll, pitch, yaw])
    assert matrix_of(quaternion_of_euler(roll, pitch, yaw)) == pytest.approx(fixed.as_matrix(), abs=1e-12)
    axis = np.array([0.36, 0.48, -0.8])
    wanted = Rotation.from_rotvec(yaw * axis).as_matrix()
    assert matrix_of(quaternion_about(axis, yaw)) == pytest.approx(wanted, abs=1e-12)


@given(angle=st.floats(-1000, 1000))
def test_a_wrapped_angle_is_the_same_direction_within_half_a_turn(angle: float) -> None:
    wrapped = wrapped_rad(angle)
    assert -math.pi <= wrapped <= math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-9)


@given(yaw=angles, pitch=st.floats(-1.5, 1.5), roll=angles, other=angles)
def test_turns_after_one_another(yaw: float, pitch: float, roll: float, other: float) -> None:
    quaternion, second = _quaternion(yaw, pitch, roll), _quaternion(other, -0.3, yaw)
    both, vector = np.zeros(4), np.zeros(3)
    mujoco.mju_mulQuat(both, quaternion, second)
    mujoco.mju_rotVecQuat(vector, np.array([1.0, -2.0, 3.0]), quaternion)
    np.testing.assert_allclose(product(quaternion, second), both, atol=1e-12)
    np.testing.assert_allclose(turned(quaternion, np.array([1.0, -2.0, 3.0])), vector, atol=1e-12)
    np.testing.assert_allclose(product(inverse(quaternion), quaternion), [1, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(about_z(yaw), _quaternion(yaw, 0.0, 0.0), atol=1e-12)


def test_a_steady_motion_is_seen_in_the_frame_of_the_body() -> None:
    velocity, turn = np.array([0.2, -0.1, 0.05]), np.array([0.1, -0.2, 0.8])
    first = Rotation.from_euler("zyx", [2.0, 0.1, -0.2])
    twist, position, period_s = BodyTwist(), np.array([1.0, 2.0, 0.1]), 0.02
    for index in range(20):
        now = first * Rotation.from_rotvec(turn * index * period_s)
        found = twist.of(index * period_s, position, wxyz(now.as_quat()))
        position = position + now.apply(velocity) * period_s
    np.testing.assert_allclose(found[3:], turn, atol=1e-12)
    # Averaged over 0.1 s, in which the body turns on by 0.08 rad.
    np.testing.assert_allclose(found[:3], velocity, atol=0.02)


def test_the_first_pose_and_one_after_a_gap_have_no_velocity() -> None:
    twist = BodyTwist()
    one = np.array([1.0, 0.0, 0.0, 0.0])
    assert not twist.of(0.0, np.zeros(3), one).any()
    assert not twist.of(9.0, np.ones(3), one).any()
    assert twist.of(9.02, 1.01 * np.ones(3), one).any()
    assert not twist.of(1.0, np.zeros(3), one).any()  # a clock that was set back
