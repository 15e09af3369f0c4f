"""Velocity hold: corrects what feet lose to slip, from the position and the yaw that a robot measures.

A reference pose moves as commanded. With the deviation d of the reference from the measured pose, in the
frame of the body and smoothed over `MEAN_S`, the robot is commanded the velocity v and

    v + d / TIME_S        d / TIME_S at most `MOST` of the greatest velocity

A slip that stays, as a share of v, then leaves a deviation and no error of the velocity. The reference moves
with the part of v that the legs are commanded now, less the correction, so that it does not run ahead of a
start. At rest it is where the robot is: nothing creeps.
"""

import math

import numpy as np

from hexctl.control.walks.steering import JUMP_M, JUMP_RAD, FrozenSensor
from hexctl.robot.rotations import wrapped_rad, yaw_rad
from hexctl.types import FloatArray, RobotState

#: Velocities are looked at up to this many times the greatest.
MOST_SHARE = 1e6

#: Time in which a deviation is made good, and the time constant that smooths it.
TIME_S, MEAN_S = 1.0, 0.2

#: Greatest correction, as a share of the greatest velocity.
MOST = 0.3


class VelocityHold:
    """Correction of a velocity command, by the pose where it is measured, by the yaw alone, or none.

    Attributes:
        correction: added to the command now, forward, left in m/s and turn in rad/s, (3,).
    """

    def __init__(self) -> None:
        self.correction: FloatArray = np.zeros(3)
        self._frozen_position, self._frozen_yaw = FrozenSensor(), FrozenSensor()
        self.forget()

    def forget(self) -> None:
        """Put the reference where the robot is."""
        self._yaw_rad: float | None = None
        self._position: FloatArray | None = None
        self._turned_rad = 0.0  # by how much the reference is turned from the last yaw measured
        self._ahead_m: FloatArray = np.zeros(2)  # from the position measured to the reference, in the world
        self._smooth: FloatArray = np.zeros(3)
        self.correction = np.zeros(3)

    def update(
        self, dt_s: float, state: RobotState, wanted: FloatArray, commanded: FloatArray, most: FloatArray
    ) -> FloatArray:
        """The velocity to command, (3,).

        Args:
            dt_s: since the last update.
            state: measured now.
            wanted: what is asked for, (3,); zero puts the reference where the robot is.
            commanded: what the legs walk now, (3,).
            most: greatest velocities, (3,).
        """
        yaw, position = self._measured(dt_s, state)
        if not wanted.any() or yaw is None:
            self.forget()
            self._yaw_rad, self._position = yaw, position
            return wanted
        # Squares of what is very great are not numbers.
        bounded = np.clip(wanted, -MOST_SHARE * most, MOST_SHARE * most)
        going = bounded * _share(bounded, commanded - self.correction, most)
        self._turn(dt_s, yaw, float(going[2]))
        self._travel(dt_s, position, yaw, going[:2])
        cos, sin = math.cos(yaw), math.sin(yaw)
        x, y = self._ahead_m.tolist()
        deviation = np.array([cos * x + sin * y, cos * y - sin * x, self._turned_rad])
        self._smooth = self._smooth + min(1.0, dt_s / MEAN_S) * (deviation - self._smooth)
        bound = MOST * most
        self.correction = np.clip(self._smooth / TIME_S, -bound, bound)
        return np.asarray(wanted + self.correction)

    def _measured(self, dt_s: float, state: RobotState) -> tuple[float | None, FloatArray | None]:
        """Yaw and position (2,), each None where it is not measured, or the same for too long."""
        quaternion, position = state.base_quaternion_world, state.base_position_world
        yaw: float | None = None
        if quaternion is not None and np.isfinite(quaternion).all():
            parts = [np.asarray(value) for value in quaternion]
            stands = bool(self._frozen_yaw.update(dt_s, *parts))
            yaw = None if stands else float(yaw_rad(quaternion))
        if position is None or not np.isfinite(position).all():
            return yaw, None
        parts = [np.asarray(value) for value in position[:2]]
        stands = bool(self._frozen_position.update(dt_s, *parts))
        return yaw, None if stands else position[:2].copy()

    def _turn(self, dt_s: float, yaw: float, rate_rad_s: float) -> None:
        """Move the reference yaw, and compare."""
        turned = 0.0 if self._yaw_rad is None else wrapped_rad(yaw - self._yaw_rad)
        if self._yaw_rad is None or abs(turned) > JUMP_RAD:
            self._turned_rad = 0.0
        else:
            bound = MOST * TIME_S * math.tau
            self._turned_rad = float(np.clip(self._turned_rad + rate_rad_s * dt_s - turned, -bound, bound))
        self._yaw_rad = yaw

    def _travel(self, dt_s: float, position: FloatArray | None, yaw: float, velocity: FloatArray) -> None:
        """Move the reference position, and compare; without a position there is no deviation."""
        before, self._position = self._position, position
        if before is None or position is None or float(np.hypot(*(position - before))) > JUMP_M:
            self._ahead_m = np.zeros(2)
            return
        cos, sin = math.cos(yaw), math.sin(yaw)
        going = np.array([cos * velocity[0] - sin * velocity[1], sin * velocity[0] + cos * velocity[1]])
        self._ahead_m = self._ahead_m + going * dt_s - (position - before)


def _share(wanted: FloatArray, commanded: FloatArray, most: FloatArray) -> float:
    """Share of the wanted velocity that is commanded now, 0 to 1."""
    scale = np.maximum(most, 1e-9)
    asked, now = wanted / scale, commanded / scale
    squared = float(asked @ asked)
    return float(np.clip(asked @ now / squared, 0.0, 1.0)) if squared > 0 else 0.0
