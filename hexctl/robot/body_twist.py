"""Velocity of a body in its own frame, from successive poses."""

import math
from collections import deque

import numpy as np

from hexctl.types import FloatArray

#: Averaging time: the difference of two poses a tick apart is mostly noise.
AVERAGED_S = 0.1

#: Maximum gap between two poses of a motion.
MOST_S = 0.5


class BodyTwist:
    """Velocity of a body: v = R(q)^T (p - p_before) / dt, omega = log(q_before^-1 q) / dt."""

    def __init__(self) -> None:
        self._poses: deque[tuple[float, FloatArray, FloatArray]] = deque()

    def of(self, at_s: float, position_world: FloatArray, quaternion_world: FloatArray) -> FloatArray:
        """Velocity in m/s and angular velocity in rad/s in the body's frame, (6,); 0 after a gap.

        The quaternion is (w, x, y, z); the position is in m.
        """
        poses = self._poses
        if poses and not 0 <= at_s - poses[-1][0] <= MOST_S:
            poses.clear()
        poses.append((at_s, position_world, quaternion_world))
        while len(poses) > 2 and at_s - poses[1][0] >= AVERAGED_S:
            poses.popleft()
        before_s, before_m, before = poses[0]
        took_s = at_s - before_s
        if took_s <= 0:
            return np.zeros(6)
        moved = _turned_back(quaternion_world, (position_world - before_m) / took_s)
        return np.array([*moved, *(one / took_s for one in _turn_between(before, quaternion_world))])


def _turned_back(quaternion: FloatArray, vector: FloatArray) -> tuple[float, float, float]:
    """Vector of the world in the frame of a body, R(q)^T v."""
    w, i, j, k = quaternion.tolist()
    x, y, z = vector.tolist()
    a, b, c = y * k - z * j, z * i - x * k, x * j - y * i  # v x u, with u the vector part of q
    return (
        x + 2 * (w * a + b * k - c * j),
        y + 2 * (w * b + c * i - a * k),
        z + 2 * (w * c + a * j - b * i),
    )


def _turn_between(before: FloatArray, now: FloatArray) -> tuple[float, float, float]:
    """Rotation vector between two orientations, in the frame of the body."""
    w0, x0, y0, z0 = before.tolist()
    w1, x1, y1, z1 = now.tolist()
    w = w0 * w1 + x0 * x1 + y0 * y1 + z0 * z1
    x = w0 * x1 - x0 * w1 - y0 * z1 + z0 * y1
    y = w0 * y1 + x0 * z1 - y0 * w1 - z0 * x1
    z = w0 * z1 - x0 * y1 + y0 * x1 - z0 * w1
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 if sine < 1e-9 else 2 * math.atan2(sine, abs(w)) / sine
    scale = -scale if w < 0 else scale
    return scale * x, scale * y, scale * z
