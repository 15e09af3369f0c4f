"""Velocities that a gait can walk, in every direction and turn."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from hexctl.control.assessment.speed_envelope import DIRECTIONS_RAD, speed_limits
from hexctl.gait.gait import Gait
from hexctl.robot.model import Robot
from hexctl.types import N_LEGS, ArrayFields, FloatArray

#: Points of a cycle at which strokes are tried: a third of those of `hexctl check`, because a robot waits.
POINTS = 40


@dataclass(frozen=True, slots=True, eq=False)
class VelocityLimits(ArrayFields):
    """Maximum velocities of a gait, with all legs in row 0 and without leg k in row k.

    Attributes:
        speeds_m_s: of travel along `DIRECTIONS_RAD`, (7, 8).
        turn_rates_rad_s: of a turn in place, (7,).
    """

    speeds_m_s: FloatArray
    turn_rates_rad_s: FloatArray

    @classmethod
    def of(cls, robot: Robot, gait: Gait) -> "VelocityLimits":
        """Limits of a gait, cached by its strides."""
        plain = replace(gait, slots=(1,) * N_LEGS, phases=None)  # the order of the legs does not matter
        return _limits(robot, plain)

    def limited(self, velocity: FloatArray, failed_legs: Sequence[int] = ()) -> FloatArray:
        """Velocity, (3,), within the limits, its direction kept: forward and left in m/s, turn in rad/s.

        The shares of travel and turn in their maxima add up to 1 at most.
        """
        rows = list(failed_legs) or [0]
        speed_m_s = math.hypot(velocity[0], velocity[1])
        most_m_s = self._speed_m_s(math.atan2(velocity[1], velocity[0]), rows)
        most_rad_s = float(self.turn_rates_rad_s[rows].min())
        if min(most_m_s, most_rad_s) <= 0:
            return np.zeros(3)
        share = speed_m_s / most_m_s + abs(velocity[2]) / most_rad_s
        return np.asarray(velocity / max(1.0, share))

    def _speed_m_s(self, heading_rad: float, rows: Sequence[int]) -> float:
        speeds = self.speeds_m_s[rows].min(axis=0)
        return float(np.interp(heading_rad % math.tau, [*DIRECTIONS_RAD, math.tau], [*speeds, speeds[0]]))


@lru_cache(maxsize=64)
def _limits(robot: Robot, gait: Gait) -> VelocityLimits:
    return VelocityLimits(*speed_limits(robot, gait, points=POINTS))
