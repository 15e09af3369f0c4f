"""Velocity of a body in its own frame, from successive poses."""

import math
from collections import deque

import numpy as np

from hexctl.robot.rotations import inverse, product, turned
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
        moved = turned(inverse(quaternion_world), (position_world - before_m) / took_s)
        turn_rad = _rotation_vector(product(inverse(before), quaternion_world))
        return np.concatenate([moved, turn_rad / took_s])


def _rotation_vector(quaternion: FloatArray) -> FloatArray:
    """Axis times angle, (3,), of the shorter turn."""
    w, sine = float(quaternion[0]), float(np.linalg.norm(quaternion[1:]))
    scale = 2.0 if sine < 1e-9 else 2 * math.atan2(sine, abs(w)) / sine
    return np.asarray((-scale if w < 0 else scale) * quaternion[1:])
