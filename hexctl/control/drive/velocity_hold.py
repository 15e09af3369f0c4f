"""Velocity hold: corrects slip by the measured position and yaw.

A reference pose moves as commanded. d is its deviation from the measured pose in the body frame, smoothed
over `MEAN_S`. The commanded velocity v becomes

    v + d / TIME_S        d / TIME_S at most `MOST` of the maximum velocity

A constant slip then leaves a deviation, but no velocity error. The reference moves with the part of v that
the legs walk now, without the correction, and does not run ahead of a start. At rest it follows the robot:
nothing creeps.
"""

import math

import numpy as np

from hexctl.control.walks.sensor_loss import JUMP_M, JUMP_RAD, FrozenSensor
from hexctl.robot.rotations import wrapped_rad, yaw_rad
from hexctl.types import FloatArray, RobotState

#: Commands are clipped to this multiple of the maximum.
MOST_SHARE = 1e6

#: Time in which a deviation is corrected, and the time constant of its smoothing.
TIME_S, MEAN_S = 1.0, 0.2

#: Maximum correction, as a share of the maximum velocity.
MOST = 0.3


class VelocityHold:
    """Correction of a velocity command by the measured pose, by only the yaw, or none."""

    def __init__(self) -> None:
        self.correction: FloatArray = np.zeros(3)
        self._frozen_position, self._frozen_yaw = FrozenSensor(), FrozenSensor()
        self.forget()

    def forget(self) -> None:
        """Set the reference to the robot's pose."""
        self._yaw_rad: float | None = None
        self._position: FloatArray | None = None
        self._turned_rad = 0.0  # from the last yaw measured to the reference
        self._ahead_m: FloatArray = np.zeros(2)  # from the last position to the reference, in the world
        self._smooth: FloatArray = np.zeros(3)
        self.correction = np.zeros(3)

    def update(
        self,
        dt_s: float,
        state: RobotState,
        desired: FloatArray,
        commanded: FloatArray,
        most: FloatArray,
        *,
        body_yaw_rad: float = 0.0,
    ) -> FloatArray:
        """Velocity to command, (3,): forward and left in m/s, turn in rad/s, as are all velocities here.

        `commanded` is what the legs walk now, `most` the maximum; a `desired` of 0 resets the reference.
        `body_yaw_rad` is that of the body over the feet, which carry the frame of the velocities.
        """
        yaw, position = self._measured(dt_s, state)
        yaw = None if yaw is None else yaw - body_yaw_rad
        if not desired.any() or yaw is None:
            self.forget()
            self._yaw_rad, self._position = yaw, position
            return desired
        # The squares of very large commands overflow.
        bounded = np.clip(desired, -MOST_SHARE * most, MOST_SHARE * most)
        going = bounded * _share(bounded, commanded - self.correction, most)
        self._turn(dt_s, yaw, float(going[2]))
        self._travel(dt_s, position, yaw, going[:2])
        cos, sin = math.cos(yaw), math.sin(yaw)
        x, y = self._ahead_m.tolist()
        deviation = np.array([cos * x + sin * y, cos * y - sin * x, self._turned_rad])
        self._smooth = self._smooth + min(1.0, dt_s / MEAN_S) * (deviation - self._smooth)
        bound = MOST * most
        self.correction = np.clip(self._smooth / TIME_S, -bound, bound)
        return np.asarray(desired + self.correction)

    def _measured(self, dt_s: float, state: RobotState) -> tuple[float | None, FloatArray | None]:
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


def _share(desired: FloatArray, commanded: FloatArray, most: FloatArray) -> float:
    """Share of the desired velocity that the legs walk now, 0 to 1."""
    scale = np.maximum(most, 1e-9)
    asked, now = desired / scale, commanded / scale
    squared = float(asked @ asked)
    return float(np.clip(asked @ now / squared, 0.0, 1.0)) if squared > 0 else 0.0
