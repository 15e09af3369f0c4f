"""Refuse feet out of reach and joints out of range, naming leg and joint."""

import numpy as np

from hexctl.errors import LimitError, ReachError
from hexctl.ik.kinematics import solve_legs
from hexctl.robot.model import Robot
from hexctl.robot.stance import leg_reach_m
from hexctl.types import JOINT_KINDS, JOINTS_PER_LEG, FloatArray

#: Rounding of the stance itself must not count as out of range.
TOLERANCE_RAD = 1e-9


def solve_legs_within_limits(robot: Robot, feet_body: FloatArray) -> FloatArray:
    """Return joint angles, leading shape + (18,), of feet that all legs can take.

    Raises ReachError or LimitError that names the first leg and joint, the value and what is allowed.
    """
    solution = solve_legs(robot, feet_body)
    if not solution.reachable.all():
        raise ReachError(_reach_message(robot, feet_body, int(np.argwhere(~solution.reachable)[0][-1])))
    check_joint_limits(robot, solution.joint_positions_rad)
    return solution.joint_positions_rad


def check_joint_limits(robot: Robot, joint_positions_rad: FloatArray) -> None:
    """Raise LimitError for the worst joint of angles, leading shape + (18,), outside their range."""
    beyond = range_excess_rad(robot, joint_positions_rad).reshape(-1, robot.joint_lower_rad.size)
    if beyond.max(initial=-np.inf) <= TOLERANCE_RAD:
        return
    row, joint = np.unravel_index(int(beyond.argmax()), beyond.shape)
    angle = joint_positions_rad.reshape(beyond.shape)[row, joint]
    leg, kind = divmod(int(joint), JOINTS_PER_LEG)
    low, high = np.degrees([robot.joint_lower_rad[joint], robot.joint_upper_rad[joint]])
    raise LimitError(
        f"leg {leg + 1} {JOINT_KINDS[kind]}: needs {np.degrees(angle):.1f} deg; "
        f"allowed: {low:g} to {high:g} deg"
    )


def range_excess_rad(robot: Robot, joint_positions_rad: FloatArray) -> FloatArray:
    """Return how far each joint is outside its range, negative inside; same shape, leading shape + (18,)."""
    return np.maximum(
        robot.joint_lower_rad - joint_positions_rad, joint_positions_rad - robot.joint_upper_rad
    )


def _reach_message(robot: Robot, feet_body: FloatArray, leg_index: int) -> str:
    """Say how far the worst foot of a leg is from its femur joint, and how far it may be."""
    coxa, femur, tibia = (tuple(vector) for vector in robot.link_vectors_m.tolist())
    from_mount = feet_body[..., leg_index, :].reshape(-1, 3) - robot.mount_positions_body[leg_index]
    distance = np.hypot(np.hypot(from_mount[:, 0], from_mount[:, 1]) - coxa[0], from_mount[:, 2] - coxa[1])
    least, most = leg_reach_m(femur, tibia)
    worst = distance[np.maximum(least - distance, distance - most).argmax()]
    return (
        f"leg {leg_index + 1}: foot {worst:.4f} m from its femur joint; allowed: {least:.4f} to {most:.4f} m"
    )
