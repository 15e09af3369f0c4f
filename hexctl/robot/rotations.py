"""Yaw and tilt of an orientation quaternion (w, x, y, z), z up."""

import math
from typing import TypeVar

import numpy as np

from hexctl.types import FloatArray

ComponentT = TypeVar("ComponentT", float, FloatArray)


def yaw_rad(quaternion: FloatArray) -> FloatArray:
    """Yaw about the vertical of quaternions, leading shape + (4,), in (-pi, pi]: leading shape in rad."""
    w, x, y, z = components(quaternion)
    return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def components(quaternion: FloatArray) -> tuple[FloatArray, ...]:
    """The four components of quaternions, leading shape each: scalars, which are faster, of a single one."""
    w, x, y, z = quaternion[..., 0], quaternion[..., 1], quaternion[..., 2], quaternion[..., 3]
    return w[()], x[()], y[()], z[()]


def cos_tilt(x: ComponentT, y: ComponentT) -> ComponentT:
    """Cosine of the angle between the body's z axis and the vertical: 1 - 2 (x^2 + y^2).

    x and y are components of the quaternion, plain numbers or arrays.
    """
    return 1 - 2 * (x * x + y * y)


def wrapped_rad(angle_rad: float) -> float:
    """Equal angle in [-pi, pi]."""
    return math.remainder(angle_rad, math.tau)
