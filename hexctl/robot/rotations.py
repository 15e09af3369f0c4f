"""Orientations, z up: quaternions (w, x, y, z), their yaw and tilt, products, levelling, and frames."""

import math
from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from hexctl.types import FloatArray

ComponentT = TypeVar("ComponentT", float, FloatArray)


def yaw_rad(quaternion: FloatArray) -> FloatArray:
    """Yaw about the vertical of quaternions, leading shape + (4,), in (-pi, pi]: leading shape in rad."""
    return yaw_of(*components(quaternion))


def yaw_of(w: FloatArray, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    """As `yaw_rad`, of `components`."""
    return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def roll_pitch_rad(quaternion: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Roll and pitch of quaternions (REP 103: turns about x, then y, then z), leading shape each in rad."""
    w, x, y, z = components(quaternion)
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    return roll, np.arcsin(np.minimum(np.maximum(2 * (w * y - z * x), -1.0), 1.0))


def components(quaternion: FloatArray) -> tuple[FloatArray, ...]:
    """The four components of quaternions, leading shape each; scalars, which are faster, for a single one."""
    w, x, y, z = quaternion[..., 0], quaternion[..., 1], quaternion[..., 2], quaternion[..., 3]
    return w[()], x[()], y[()], z[()]


def cos_tilt(x: ComponentT, y: ComponentT) -> ComponentT:
    """Cosine of the angle between the body's z axis and the vertical: 1 - 2 (x^2 + y^2), of a quaternion."""
    return 1 - 2 * (x * x + y * y)


def wrapped_rad(angle_rad: float) -> float:
    """Equal angle in [-pi, pi]."""
    return math.remainder(angle_rad, math.tau)


def about_z(angle_rad: float) -> FloatArray:
    """Quaternion (4,) of a turn about the vertical, counter-clockwise."""
    return np.array([math.cos(angle_rad / 2), 0.0, 0.0, math.sin(angle_rad / 2)])


def quaternion_about(axis: Sequence[float] | FloatArray, angle_rad: float) -> FloatArray:
    """Quaternion (4,) of a turn about a unit axis, (3,)."""
    x, y, z = axis
    sin = math.sin(angle_rad / 2)
    return np.array([math.cos(angle_rad / 2), sin * x, sin * y, sin * z])


def quaternion_of_euler(roll_rad: float, pitch_rad: float, yaw_rad: float) -> FloatArray:
    """Quaternion (4,) of turns about the fixed axes x, then y, then z, as in URDF and aerospace."""
    cr, sr = math.cos(roll_rad / 2), math.sin(roll_rad / 2)
    cp, sp = math.cos(pitch_rad / 2), math.sin(pitch_rad / 2)
    cy, sy = math.cos(yaw_rad / 2), math.sin(yaw_rad / 2)
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def matrix_of(quaternion: FloatArray) -> FloatArray:
    """Rotation matrix (3, 3) of a unit quaternion (4,)."""
    w, x, y, z = quaternion.tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def frame_of(position_m: FloatArray | Sequence[float], quaternion: FloatArray | None = None) -> FloatArray:
    """Frame (4, 4) at a position (3,), turned by a unit quaternion (4,)."""
    frame = np.eye(4)
    frame[:3, 3] = position_m
    if quaternion is not None:
        frame[:3, :3] = matrix_of(quaternion)
    return frame


def transformed_points(points: FloatArray, frame: FloatArray) -> FloatArray:
    """Points (N, 3) or (3,) of a frame (4, 4) in the frame around it."""
    return np.asarray(points @ frame[:3, :3].T + frame[:3, 3])


def xyzw(quaternion: FloatArray) -> FloatArray:
    """Quaternions in the order of ROS, Rerun and SciPy (x, y, z, w), any leading shape + (4,)."""
    return quaternion[..., [1, 2, 3, 0]]


def wxyz(quaternion: FloatArray) -> FloatArray:
    """Quaternions (w, x, y, z) of those in the order of ROS, Rerun and SciPy, any leading shape + (4,)."""
    return quaternion[..., [3, 0, 1, 2]]


def product(first: FloatArray, second: FloatArray) -> FloatArray:
    """Quaternion (4,) of the turn `second` followed by the turn `first`, both (4,)."""
    a, i, j, k = first.tolist()
    b, x, y, z = second.tolist()
    return np.array(
        [
            a * b - i * x - j * y - k * z,
            a * x + i * b + j * z - k * y,
            a * y - i * z + j * b + k * x,
            a * z + i * y - j * x + k * b,
        ]
    )


def inverse(quaternion: FloatArray) -> FloatArray:
    """Unit quaternion (4,) of the opposite turn."""
    return np.asarray(quaternion * np.array([1.0, -1.0, -1.0, -1.0]))


def turned(quaternion: FloatArray, vector: FloatArray) -> FloatArray:
    """Vector (3,) turned by a unit quaternion (4,)."""
    pure = np.concatenate([[0.0], vector])
    return product(product(quaternion, pure), inverse(quaternion))[1:]


def levelled(points: FloatArray, up: FloatArray) -> FloatArray:
    """Points (N, 3) after the shortest turn that makes a direction (3,), not straight down, vertical."""
    up = up / np.linalg.norm(up, axis=-1, keepdims=True)
    x, y, z = (up[..., axis, np.newaxis] for axis in range(3))
    # Rodrigues' formula for the turn from `up` to the z axis.
    upward = x * points[..., 0] + y * points[..., 1] + z * points[..., 2]
    along = (upward + points[..., 2]) / (1 + z)
    return np.stack([points[..., 0] - x * along, points[..., 1] - y * along, upward], axis=-1)
