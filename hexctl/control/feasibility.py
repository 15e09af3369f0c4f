"""What a gait asks of a robot's joints, in numbers: range, reach, speed, spacing of the feet."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hexctl.gait.foot_trajectory import RAMP_DURATION_S, gait_feet_body
from hexctl.gait.gait import Gait, Motion
from hexctl.ik.legs import TOLERANCE_RAD, range_excess_rad, solve_legs
from hexctl.robot.model import Robot
from hexctl.types import FloatArray

#: Points of one gait cycle that are looked at.
POINTS = 720


@dataclass(frozen=True, slots=True)
class GaitDemand:
    """The demand of a gait at full stride, the worst over motions and time.

    Attributes:
        lowest_rad: least joint angles, (18,).
        highest_rad: greatest joint angles, (18,).
        peak_speed_rad_s: greatest joint speeds, (18,).
        unreachable_legs: legs 1..6 with a foot out of reach.
        limits_exceeded: indices of joints that leave their range.
        max_pace_hz: the greatest pace at which no joint exceeds its speed limit; None in a turn, whose stroke
            grows as the pace shrinks.
        speed_holds: whether no joint exceeds its speed limit at the gait's own pace.
        least_foot_spacing_m: how near two neighbouring feet come.
    """

    lowest_rad: FloatArray
    highest_rad: FloatArray
    peak_speed_rad_s: FloatArray
    unreachable_legs: tuple[int, ...]
    limits_exceeded: tuple[int, ...]
    max_pace_hz: float | None
    speed_holds: bool
    least_foot_spacing_m: float

    @property
    def possible(self) -> bool:
        """Return whether every foot is in reach and every joint in its range."""
        return not (self.unreachable_legs or self.limits_exceeded)


def gait_demand(robot: Robot, gait: Gait, motions: Sequence[Motion]) -> GaitDemand:
    """Return what a gait demands in any of the motions."""
    cycle_s = np.arange(POINTS + 1) / (POINTS * gait.pace_hz)
    time_s = RAMP_DURATION_S + cycle_s
    feet = np.stack([gait_feet_body(robot, gait, motion, time_s) for motion in motions])
    solution = solve_legs(robot, feet)
    joints = solution.joint_positions_rad  # (motions, points, 18)
    speed = np.abs(np.diff(joints, axis=1)).max(axis=(0, 1)) / cycle_s[1]
    lowest, highest = joints.min(axis=(0, 1)), joints.max(axis=(0, 1))
    outside = range_excess_rad(robot, np.stack([lowest, highest])).max(axis=0) > TOLERANCE_RAD
    in_reach = solution.reachable.all(axis=(0, 1))
    spacing = np.linalg.norm(feet - np.roll(feet, -1, axis=-2), axis=-1)
    share = float((robot.joint_max_speed_rad_s / np.maximum(speed, 1e-9)).min())
    turning = any(motion.turn_rate_rad_s for motion in motions)
    return GaitDemand(
        lowest_rad=lowest,
        highest_rad=highest,
        peak_speed_rad_s=speed,
        unreachable_legs=tuple(int(leg) + 1 for leg in np.flatnonzero(~in_reach)),
        limits_exceeded=tuple(int(joint) for joint in np.flatnonzero(outside)),
        max_pace_hz=None if turning else gait.pace_hz * share,
        speed_holds=share >= 1,
        least_foot_spacing_m=float(spacing.min()),
    )
