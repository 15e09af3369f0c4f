"""What the guard lets through, as plain array mathematics for one robot or a batch of them."""

from dataclasses import dataclass

import numpy as np

from hexctl.robot.model import Robot
from hexctl.robot.rotations import cos_tilt
from hexctl.types import BoolArray, FloatArray

#: A body that leans further than this, for this long, has fallen.
FALL_COS_TILT = float(np.cos(np.radians(50)))
FALL_TICKS = 10


@dataclass(frozen=True, slots=True)
class StepLimits:
    """Joint ranges and the greatest step of one control period.

    Attributes:
        lower_rad: (18,).
        upper_rad: (18,).
        max_step_rad: joint speed limit times the period, (18,).
    """

    lower_rad: FloatArray
    upper_rad: FloatArray
    max_step_rad: FloatArray

    @classmethod
    def of(cls, robot: Robot, period_s: float) -> "StepLimits":
        """Return the limits of a robot that is commanded once per period."""
        return cls(robot.joint_lower_rad, robot.joint_upper_rad, robot.joint_max_speed_rad_s * period_s)

    def apply(self, wanted_rad: FloatArray, accepted_rad: FloatArray) -> FloatArray:
        """Return the targets nearest to the wanted ones that range and speed allow.

        Speed goes first: a joint found outside its range comes back to it no faster than it may turn.

        Args:
            wanted_rad: leading shape + (18,).
            accepted_rad: the last accepted targets, same shape; the step is taken from there.
        """
        within = np.minimum(np.maximum(wanted_rad, self.lower_rad), self.upper_rad)
        slowest, fastest = accepted_rad - self.max_step_rad, accepted_rad + self.max_step_rad
        return np.minimum(np.maximum(within, slowest), fastest)


def leaning(base_quaternion_world: FloatArray) -> BoolArray:
    """Return whether a body leans too far, for orientations leading shape + (4,)."""
    x, y = base_quaternion_world[..., 1], base_quaternion_world[..., 2]
    return np.asarray(cos_tilt(x, y) < FALL_COS_TILT)
