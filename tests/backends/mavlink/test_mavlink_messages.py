"""Frames against rotation matrices made another way, and the signs that a pilot would check."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hexctl.backends.mavlink.mavlink_messages import (
    Outputs,
    Pose,
    euler_of_quaternion,
    flipped_quaternion,
    flipped_vector,
    quaternion_of_euler,
)
from hexctl.types import FloatArray

#: Axes of NED or FRD written in ours: x stays, y and z turn over.
AXES = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])

angles = st.floats(-3.1, 3.1)
pitches = st.floats(-1.5, 1.5)


def matrix(quaternion: FloatArray) -> FloatArray:
    return np.asarray(Rotation.from_quat(np.roll(quaternion, -1)).as_matrix())


@given(roll=angles, pitch=pitches, yaw=angles)
def test_an_orientation_is_the_same_rotation_in_other_axes(roll: float, pitch: float, yaw: float) -> None:
    ned = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    ours = matrix(flipped_quaternion(quaternion_of_euler(roll, pitch, yaw)))
    np.testing.assert_allclose(ours, AXES @ ned @ AXES.T, atol=1e-9)


@given(roll=angles, pitch=pitches, yaw=angles)
def test_euler_angles_survive_the_round_trip(roll: float, pitch: float, yaw: float) -> None:
    back = euler_of_quaternion(quaternion_of_euler(roll, pitch, yaw))
    np.testing.assert_allclose(back, (roll, pitch, yaw), atol=1e-6)


@given(st.tuples(*[st.floats(-100, 100)] * 3))
def test_the_way_back_is_the_way_there(values: tuple[float, float, float]) -> None:
    vector = np.array(values)
    np.testing.assert_array_equal(flipped_vector(flipped_vector(vector)), vector)


def test_a_position_above_the_ground_and_to_the_left() -> None:
    """North 1, east 2, 3 above the ground is x 1, y -2, z 3."""
    np.testing.assert_array_equal(flipped_vector(np.array([1.0, 2.0, -3.0])), [1.0, -2.0, 3.0])


@pytest.mark.parametrize(
    ("roll", "pitch", "yaw", "axis", "turn"),
    [
        (0.3, 0, 0, (1, 0, 0), 0.3),  # right side down: about forward, the same
        (0, 0.3, 0, (0, 1, 0), -0.3),  # nose up: about left, the other way
        (0, 0, 0.3, (0, 0, 1), -0.3),  # to the right: about up, the other way
    ],
)
def test_signs_of_roll_pitch_and_yaw(
    roll: float, pitch: float, yaw: float, axis: tuple[float, float, float], turn: float
) -> None:
    quaternion = flipped_quaternion(quaternion_of_euler(roll, pitch, yaw))
    expected = [math.cos(turn / 2), *(math.sin(turn / 2) * np.array(axis))]
    np.testing.assert_allclose(quaternion, expected, atol=1e-12)


def test_what_a_board_says_compares_by_value() -> None:
    active = np.ones(18, dtype=bool)
    pulses = np.where(np.arange(18) == 3, np.nan, 1500.0)
    assert Outputs(pulses, active) == Outputs(pulses.copy(), active.copy())
    assert Outputs(pulses, active) != Outputs(pulses, ~active)
    assert Pose(np.zeros(3), np.eye(4)[0]) == Pose(np.zeros(3), np.eye(4)[0])
