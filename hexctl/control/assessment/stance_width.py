"""The stance width for five legs: the drive that the servos need there, over stance widths.

Without a leg its neighbours carry up to twice the load, and the lever of a joint grows with the width. A
motor holds the static torque tau of its joint, overcomes its dry friction and its back-EMF b w at the joint
speed w, and needs the share of its stall torque

    u = |tau + tau_dry sign(w) + b w| / tau_stall

of its drive. With u above 1 the joint does not follow, and the body sinks. The proposed width is the one of
the robot if u stays below 1 on any five legs, else the widest one at which it does.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hexctl.control.assessment.crawl import gait_without
from hexctl.control.assessment.static_stability import STAND_UP
from hexctl.errors import InputError
from hexctl.gait.foot_trajectory import RAMP_DURATION_S, gait_feet_body
from hexctl.gait.gait import Gait, Motion
from hexctl.ik.legs import legs_that_reach, solve_legs
from hexctl.ik.statics import static_load
from hexctl.robot.model import Robot, in_stance_of
from hexctl.types import N_LEGS, FloatArray

#: Points of a gait cycle, and directions of travel: bodies are symmetric.
POINTS, HEADINGS_RAD = 36, (0.0, math.pi / 2)

#: Widths of the search, as shares of the robot's.
SHARES = tuple(0.98 - 0.02 * step for step in range(25))


@dataclass(frozen=True, slots=True, kw_only=True)
class StanceWidth:
    """The stance of a robot, and the proposed one.

    Attributes:
        outward_m: distance of the nominal feet from the coxa axes.
        drive: largest share of a servo's drive on five legs, at 1 all that it has; inf if a foot is out of
            reach, its joints out of their ranges, or the robot tips over.
        proposed_m: the proposed distance, `outward_m` if it is right.
        proposed_drive: the drive that it needs.
    """

    outward_m: float
    drive: float
    proposed_m: float
    proposed_drive: float

    def to_dict(self) -> dict[str, Any]:
        """JSON values."""
        return {
            "stance_outward_m": round(self.outward_m, 4),
            "five_leg_drive": _rounded(self.drive),
            "proposed_outward_m": round(self.proposed_m, 4),
            "proposed_five_leg_drive": _rounded(self.proposed_drive),
        }


def _rounded(drive: float) -> float | None:
    return round(drive, 3) if math.isfinite(drive) else None


def stance_width(robot: Robot, gait: Gait) -> StanceWidth:
    """Stance width of a robot on five legs, in the gaits that its recovery glides to, and the proposed one.

    The gait gives pace, strokes and posture.
    """
    walks = _five_leg_walks(robot, gait)
    own_m, drive = robot.stance_outward_m, _drive(robot, walks)
    proposed_m, least = (own_m, drive) if drive <= 1 else _widest(robot, walks, drive)
    return StanceWidth(outward_m=own_m, drive=drive, proposed_m=proposed_m, proposed_drive=least)


Walks = Sequence[tuple[Gait, Motion]]


def _five_leg_walks(robot: Robot, gait: Gait) -> Walks:
    posture = replace(gait.posture, body_raise=gait.posture.body_raise or STAND_UP)
    raised = replace(gait, posture=posture)
    return [
        (gait_without(robot, raised, heading_rad=heading_rad, legs=(leg,)), Motion(heading_rad=heading_rad))
        for heading_rad in HEADINGS_RAD
        for leg in range(1, N_LEGS + 1)
    ]


def _widest(robot: Robot, walks: Walks, drive: float) -> tuple[float, float]:
    """The widest stance in m whose drive is at most 1, and its drive; else the one with the least drive."""
    best_m = own_m = robot.stance_outward_m
    for share in SHARES:
        width_m = round(share * own_m, 3)
        if (now := _drive_at(robot, walks, width_m)) < drive:
            best_m, drive = width_m, now
        if now <= 1:
            break
    return best_m, drive


def _drive_at(robot: Robot, walks: Walks, width_m: float) -> float:
    try:
        return _drive(in_stance_of(robot, width_m), walks)
    except InputError:  # out of reach
        return math.inf


def _drive(robot: Robot, walks: Walks) -> float:
    """Largest share of a servo's drive over the cycles of some walks; inf if they cannot carry the robot."""
    feet = np.stack([_feet(robot, gait, motion) for gait, motion in walks])  # (walks, points, 6, 3)
    spacing_m = np.linalg.norm(feet - np.roll(feet, -1, axis=-2), axis=-1)
    if spacing_m.min() < 2 * robot.foot_radius_m or not legs_that_reach(robot, feet).all():
        return math.inf
    joints = solve_legs(robot, feet).joint_positions_rad
    paces_hz = np.array([gait.pace_hz for gait, _ in walks])[:, np.newaxis, np.newaxis]
    speed_rad_s = POINTS * paces_hz * (np.roll(joints, -1, axis=1) - np.roll(joints, 1, axis=1)) / 2
    load = static_load(robot, joints)
    moving_nm = robot.dry_friction_nm * np.sign(speed_rad_s) + robot.back_emf_nm_s_per_rad * speed_rad_s
    shares = np.abs(load.torques_nm + moving_nm) / robot.joint_max_torque_nm
    return float(shares.max()) if load.balanced.all() else math.inf


def _feet(robot: Robot, gait: Gait, motion: Motion) -> FloatArray:
    time_s = RAMP_DURATION_S + (np.arange(POINTS) + 0.5) / (POINTS * gait.pace_hz)
    return gait_feet_body(robot, gait, motion, time_s)
