"""Reference poses of legs, which a person can judge by eye, and how they look."""

import math

import numpy as np

from hexctl.control.calibration.operator import SEEN
from hexctl.robot.model import Robot
from hexctl.robot.servos.raw_map import reference_deg
from hexctl.types import JOINTS_PER_LEG, FloatArray


def leg_pose_deg(robot: Robot, leg: int) -> tuple[float, ...]:
    """Joint angles of a leg, 0..5, in its reference pose."""
    joints = range(JOINTS_PER_LEG * leg, JOINTS_PER_LEG * (leg + 1))
    lower, upper = np.degrees(robot.joint_lower_rad), np.degrees(robot.joint_upper_rad)
    return tuple(reference_deg(float(lower[joint]), float(upper[joint])) + 0.0 for joint in joints)  # no -0


def described_pose(robot: Robot, pose_deg: tuple[float, ...]) -> tuple[str, str, str]:
    """Description of a leg in a pose, a line per link, as seen with a protractor or a level."""
    _, femur, tibia = (math.degrees(math.atan2(up, out)) for out, up in robot.link_vectors_m.tolist())
    coxa_deg, femur_deg, tibia_deg = pose_deg
    aside = f"{abs(coxa_deg):g} deg {SEEN['coxa'][0 if coxa_deg > 0 else 1]} from " if coxa_deg else ""
    femur_rises, tibia_rises = femur + femur_deg, tibia + femur_deg + tibia_deg
    return (
        f"coxa {coxa_deg:g} deg: the leg points {aside}straight away from its mount",
        f"femur {femur_deg:g} deg: the line from its axis to the tibia's axis {_slope(femur_rises)}",
        f"tibia {tibia_deg:g} deg: the line from its axis to the tip of the foot {_slope(tibia_rises)}",
    )


def seen_at(robot: Robot, angles_deg: FloatArray, joint: int, angle_deg: float) -> str:
    """Description of a joint, 0..17, at an angle, with the other joints of its leg at theirs, of (18,)."""
    leg, kind = divmod(joint, JOINTS_PER_LEG)
    pose_deg = angles_deg[JOINTS_PER_LEG * leg : JOINTS_PER_LEG * (leg + 1)].tolist()
    pose_deg[kind] = angle_deg
    return described_pose(robot, tuple(pose_deg))[kind].partition(": ")[2]


def _slope(rises_deg: float) -> str:
    rises_deg = (rises_deg + 180) % 360 - 180
    if abs(rises_deg) < 0.5:
        return "is level"
    if abs(rises_deg + 90) < 0.5:
        return "points straight down"
    if abs(rises_deg - 90) < 0.5:
        return "points straight up"
    inward, steep = abs(rises_deg) > 90, min(abs(rises_deg), 180 - abs(rises_deg))
    way = "above" if rises_deg > 0 else "below"
    return f"runs {'inward' if inward else 'outward'}, {steep:.0f} deg {way} level"
