"""The path of the joints over a gait cycle, and the drive and the pace that it needs of their servos.

A motor holds the static torque tau of its joint, overcomes its dry friction and its back-EMF b w at the joint
speed w, and needs the share of its stall torque

    u = |tau + tau_dry sign(w) + b w| / tau_stall

of its drive. The path does not depend on the pace f: a joint that changes by q' per cycle turns at w = f q'.
It follows while w stays below its maximum speed and u below 1, which both limit the pace.
"""

import math
from dataclasses import dataclass

import numpy as np

from hexctl.gait.foot_trajectory import RAMP_DURATION_S, gait_feet_body
from hexctl.gait.gait import Gait, Motion
from hexctl.ik.legs import legs_that_reach, solve_legs
from hexctl.ik.statics import static_load
from hexctl.robot.model import Robot
from hexctl.types import ArrayFields, FloatArray

#: Points of a gait cycle: a change between two of them is what a servo can follow at all.
POINTS = 36

#: A joint that changes by less per cycle does not turn.
STILL_RAD = 1e-9


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class JointPath(ArrayFields):
    """Joints at full stride over a cycle.

    Attributes:
        changes_rad: of the joints per cycle, (points, 18).
        torques_nm: that hold the robot, (points, 18).
    """

    robot: Robot
    changes_rad: FloatArray
    torques_nm: FloatArray

    @classmethod
    def of(cls, robot: Robot, gait: Gait, motion: Motion) -> "JointPath | None":
        """Path of a gait.

        None if feet are out of reach, their joints out of their ranges, two feet touch, or the robot tips.
        """
        # From the begin of a cycle on: the points are the same at any pace.
        cycles = math.ceil(RAMP_DURATION_S * gait.pace_hz) + (np.arange(POINTS) + 0.5) / POINTS
        time_s = cycles / gait.pace_hz
        feet = gait_feet_body(robot, gait, motion, time_s)
        spacing_m = np.linalg.norm(feet - np.roll(feet, -1, axis=-2), axis=-1)
        if spacing_m.min() < 2 * robot.foot_radius_m or not legs_that_reach(robot, feet).all():
            return None
        joints = solve_legs(robot, feet).joint_positions_rad
        load = static_load(robot, joints)
        if not load.balanced.all():
            return None
        return cls(
            robot=robot,
            changes_rad=POINTS * (np.roll(joints, -1, axis=0) - np.roll(joints, 1, axis=0)) / 2,
            torques_nm=load.torques_nm,
        )

    def drive(self, pace_hz: float) -> float:
        """Largest share of a servo's drive at a pace: at 1 all that it has."""
        robot, speed_rad_s = self.robot, pace_hz * self.changes_rad
        moving_nm = robot.dry_friction_nm * np.sign(speed_rad_s) + robot.back_emf_nm_s_per_rad * speed_rad_s
        shares = np.abs(self.torques_nm + moving_nm) / robot.joint_max_torque_nm
        return float(shares.max())

    @property
    def most_pace_hz(self) -> float:
        """Pace up to which every joint follows; 0 if a servo cannot even hold its torque."""
        robot, turning_rad = self.robot, np.maximum(np.abs(self.changes_rad), STILL_RAD)
        by_speed_hz = float((robot.joint_max_speed_rad_s / turning_rad).min())
        against_nm = robot.dry_friction_nm + self.torques_nm * np.sign(self.changes_rad)
        left_nm = robot.joint_max_torque_nm - against_nm
        if left_nm.min() <= 0 or (np.abs(self.torques_nm) >= robot.joint_max_torque_nm).any():
            return 0.0
        lost_nm_s = robot.back_emf_nm_s_per_rad * turning_rad
        by_torque_hz = np.divide(left_nm, lost_nm_s, out=np.full_like(left_nm, np.inf), where=lost_nm_s > 0)
        return min(by_speed_hz, float(by_torque_hz.min()))
