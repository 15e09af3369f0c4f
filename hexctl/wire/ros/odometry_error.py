"""Covariances of `odom`: what a pose and a twist may be off, so that filters weigh them.

The shares are RMS errors of the legs' odometry in 45 simulated walks of 8 s with measured joint angles: ant,
pexod and phantomx, ahead, to the left, and turning in place, in the worlds flat, rough, slippery, real:1 and
real:2. Flat floors are a fifth of it, rough ones twice. A floor is not known, so all count.
"""

import math

import numpy as np

from hexctl.robot.body_twist import AVERAGED_S
from hexctl.types import FloatArray

#: Error of position and yaw per metre walked, and per radian turned; the yaw is that of the feet.
POSITION_PER_M, POSITION_PER_RAD = 0.12, 0.065
YAW_PER_M, YAW_PER_RAD = 0.16, 0.33

#: Joints that only echo their targets double it: 12 % instead of 4 % on flat floors, 28 % instead of 17 %.
ECHOED = 2.0

#: Drift of an IMU's yaw, in rad for each root of a second: 2 degrees in two minutes.
IMU_YAW_PER_ROOT_S = 0.003

#: Roll and pitch of an IMU, 1 degree as of usual MEMS sensors; without one the body counts as level, and
#: the steepest shipped floor has 5 degrees.
IMU_TILT_RAD, LEVEL_TILT_RAD = math.radians(1), math.radians(5)

#: Least error of a pose: the body sways by that within a tick, and moves until the message is out.
LEAST_M, LEAST_RAD = 0.003, math.radians(0.2)


class ReckoningError:
    """Standard deviations of dead reckoning: they grow with distance, turn and time, and never shrink."""

    def __init__(self) -> None:
        self.position_m = self.legs_yaw_rad = self.imu_s = 0.0

    def grow(self, moved_m: float, turned_rad: float, passed_s: float, *, measured: bool, imu: bool) -> None:
        """Take in a step: motion by the legs, the turn, and its duration."""
        factor = 1.0 if measured else ECHOED
        moved_m, turned_rad = factor * abs(moved_m), factor * abs(turned_rad)
        self.position_m += POSITION_PER_M * moved_m + POSITION_PER_RAD * turned_rad
        if imu:
            self.imu_s += passed_s
        else:
            self.legs_yaw_rad += YAW_PER_M * moved_m + YAW_PER_RAD * turned_rad

    def covariance(self, *, imu: bool) -> FloatArray:
        """Covariance of the pose, (36,)."""
        yaw_rad = math.hypot(LEAST_RAD, self.legs_yaw_rad, IMU_YAW_PER_ROOT_S * math.sqrt(self.imu_s))
        tilt_rad = IMU_TILT_RAD if imu else LEVEL_TILT_RAD
        return _diagonal(math.hypot(LEAST_M, self.position_m), tilt_rad, yaw_rad)


def own_pose_covariance() -> FloatArray:
    """Covariance (36,) of a pose that the robot measures itself, without drift."""
    return _diagonal(LEAST_M, LEAST_RAD, LEAST_RAD)


def twist_covariance(twist: FloatArray, *, reckoned: bool) -> FloatArray:
    """Covariance (36,) of a velocity (6,) in m/s and rad/s: the difference of two poses, and slip."""
    noise = math.sqrt(2) / AVERAGED_S
    slip_m_s = POSITION_PER_M * float(np.linalg.norm(twist[:3])) if reckoned else 0.0
    slip_rad_s = YAW_PER_RAD * abs(float(twist[5])) if reckoned else 0.0
    turn_rad_s = math.hypot(noise * LEAST_RAD, slip_rad_s)
    return _diagonal(math.hypot(noise * LEAST_M, slip_m_s), noise * LEAST_RAD, turn_rad_s)


def _diagonal(position: float, tilt: float, yaw: float) -> FloatArray:
    return np.diag([*3 * [position**2], *2 * [tilt**2], yaw**2]).ravel()
