"""Forward and inverse kinematics of the six legs, vectorised over any leading axes.

Leg plane: x outward from the coxa axis, z up. Femur and tibia are links with a slope of their own at joint
angle zero; a positive joint angle lifts. The knee points up: of the two solutions the one every walking
hexapod stands in.
"""

from dataclasses import dataclass

import numpy as np

from hexctl.robot.model import Robot
from hexctl.types import JOINTS_PER_LEG, N_JOINTS, N_LEGS, BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class LegAngles:
    """The inverse kinematics of foot positions.

    Attributes:
        joint_positions_rad: leading shape + (18,); finite also where a foot is out of reach: there the leg
            stretches (or folds) as far as it can in the foot's direction.
        reachable: which feet can be reached exactly, leading shape + (6,); joint limits are not asked.
    """

    joint_positions_rad: FloatArray
    reachable: BoolArray


def link_points_body(robot: Robot, joint_positions_rad: FloatArray) -> FloatArray:
    """Return coxa axis, femur joint, knee and foot of each leg, leading shape + (6, 4, 3) in m.

    Args:
        robot: geometry.
        joint_positions_rad: leading shape + (18,).
    """
    angles = _per_leg(joint_positions_rad)
    yaw = robot.mount_yaws_rad + angles[..., 0]
    slopes = np.stack([np.zeros_like(yaw), angles[..., 1], angles[..., 1] + angles[..., 2]], axis=-1)
    cos, sin = np.cos(slopes), np.sin(slopes)
    outward, up = robot.link_vectors_m[:, 0], robot.link_vectors_m[:, 1]
    radial = np.cumsum(outward * cos - up * sin, axis=-1)  # (..., 6, 3)
    height = np.cumsum(outward * sin + up * cos, axis=-1)
    ends = np.stack(
        [radial * np.cos(yaw)[..., np.newaxis], radial * np.sin(yaw)[..., np.newaxis], height], axis=-1
    )
    mounts = np.broadcast_to(robot.mount_positions_body, (*ends.shape[:-2], 3))[..., np.newaxis, :]
    return np.concatenate([mounts, mounts + ends], axis=-2)


def foot_positions_body(robot: Robot, joint_positions_rad: FloatArray) -> FloatArray:
    """Return the centres of the feet in the body frame, leading shape + (6, 3) in m."""
    return link_points_body(robot, joint_positions_rad)[..., -1, :]


def solve_legs(robot: Robot, feet_body: FloatArray) -> LegAngles:
    """Return the joint angles that put the feet at positions in the body frame.

    Law of cosines in the triangle femur joint, knee, foot.

    Args:
        robot: geometry.
        feet_body: leading shape + (6, 3) in m.
    """
    from_mount = feet_body - robot.mount_positions_body
    coxa = _wrapped(np.arctan2(from_mount[..., 1], from_mount[..., 0]) - robot.mount_yaws_rad)
    outward = np.sqrt(from_mount[..., 0] ** 2 + from_mount[..., 1] ** 2) - robot.link_vectors_m[0, 0]
    up = from_mount[..., 2] - robot.link_vectors_m[0, 1]
    femur_length, tibia_length = np.sqrt((robot.link_vectors_m[1:] ** 2).sum(axis=-1))
    femur_slope, tibia_slope = np.arctan2(robot.link_vectors_m[1:, 1], robot.link_vectors_m[1:, 0])

    distance = np.sqrt(outward**2 + up**2)
    least, most = abs(femur_length - tibia_length), femur_length + tibia_length
    reachable = (distance >= least) & (distance <= most)
    side = np.clip(distance, max(least, 1e-9), most)
    at_hip = (femur_length**2 + side**2 - tibia_length**2) / (2 * femur_length * side)
    at_knee = (femur_length**2 + tibia_length**2 - side**2) / (2 * femur_length * tibia_length)
    femur_up = np.arctan2(up, outward) + np.arccos(np.clip(at_hip, -1, 1))
    tibia_up = femur_up + np.arccos(np.clip(at_knee, -1, 1)) - np.pi
    femur = femur_up - femur_slope
    tibia = tibia_up - tibia_slope - femur
    joints = np.stack([coxa, _wrapped(femur), _wrapped(tibia)], axis=-1)
    return LegAngles(joints.reshape(*joints.shape[:-2], N_JOINTS), reachable)


def _per_leg(joint_positions_rad: FloatArray) -> FloatArray:
    """Split the joint axis, leading shape + (18,) into + (6, 3)."""
    return joint_positions_rad.reshape(*joint_positions_rad.shape[:-1], N_LEGS, JOINTS_PER_LEG)


def _wrapped(angle_rad: FloatArray) -> FloatArray:
    """Return angles in [-pi, pi]."""
    return angle_rad - 2 * np.pi * np.round(angle_rad / (2 * np.pi))
