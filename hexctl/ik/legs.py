"""Forward and inverse kinematics of the six legs, and their limits; vectorised over any leading axes.

Leg plane: x outward from the coxa axis, z up; positive joint angles lift. The inverse kinematics returns the
solution with the knee up.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hexctl.errors import LimitError, ReachError, check_type
from hexctl.robot.model import Robot, leg_reach_m
from hexctl.types import (
    JOINT_KINDS,
    JOINTS_PER_LEG,
    N_JOINTS,
    N_LEGS,
    ArrayFields,
    BoolArray,
    FloatArray,
    as_joint_angles,
    as_numbers,
    by_leg,
    check_finite,
)

#: Numbers as arrays, as those of `LegTriangle`.
_LEAST_COSINE, _MOST_COSINE = np.array(-1.0), np.array(1.0)
_HALF_TURN, _TURN = np.array(math.pi), np.array(math.tau)


@dataclass(frozen=True, slots=True, eq=False)
class LegAngles(ArrayFields):
    """A solution of the inverse kinematics.

    Attributes:
        joint_positions_rad: leading shape + (18,); toward a foot out of reach the leg stretches or folds as
            far as it can.
        reachable: which feet are within reach, leading shape + (6,), without the joint ranges.
    """

    joint_positions_rad: FloatArray
    reachable: BoolArray


def link_points_body(robot: Robot, joint_positions_rad: FloatArray) -> FloatArray:
    """Coxa axis, femur joint, knee and foot of each leg in the body frame, leading shape + (6, 4, 3) in m."""
    angles = by_leg(joint_positions_rad)
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
    """Centres of the feet in the body frame, leading shape + (6, 3) in m."""
    # As in `link_points_body`, to the same bits, in half the time.
    angles = by_leg(joint_positions_rad)
    yaw, femur = robot.mount_yaws_rad + angles[..., 0], angles[..., 1]
    tibia = femur + angles[..., 2]
    (coxa_out, femur_out, tibia_out), (coxa_up, femur_up, tibia_up) = robot.link_vectors_m.T
    cos, sin, tibia_cos, tibia_sin = np.cos(femur), np.sin(femur), np.cos(tibia), np.sin(tibia)
    radial = coxa_out + (femur_out * cos - femur_up * sin) + (tibia_out * tibia_cos - tibia_up * tibia_sin)
    height = coxa_up + (femur_out * sin + femur_up * cos) + (tibia_out * tibia_sin + tibia_up * tibia_cos)
    feet = np.empty((*yaw.shape, 3))
    feet[..., 0], feet[..., 1], feet[..., 2] = radial * np.cos(yaw), radial * np.sin(yaw), height
    return robot.mount_positions_body + feet


def solve_legs(robot: Robot, feet_body: FloatArray) -> LegAngles:
    """Joint angles that put the feet at positions in the body frame, leading shape + (6, 3) in m.

    The coxa points at the foot. In the leg plane, femur joint, knee and foot are a triangle with the sides f
    (femur), t (tibia) and d (femur joint to foot, at a slope of delta); by the law of cosines the links have
    the slopes

        femur = delta + arccos((f^2 + d^2 - t^2) / (2 f d))
        tibia = femur + arccos((f^2 + t^2 - d^2) / (2 f t)) - pi

    The joint angles are these slopes less the links' slopes at angle zero.
    """
    joints_rad, side, distance = _solved(robot, feet_body)
    return LegAngles(joints_rad, reachable=side == distance)


def leg_joints_rad(robot: Robot, feet_body: FloatArray) -> FloatArray:
    """Joint angles of `solve_legs`, without the check of the reach."""
    return _solved(robot, feet_body)[0]


def _solved(robot: Robot, feet_body: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Joint angles, the side d as far as the legs reach, and the whole distance."""
    leg = robot.leg_triangle
    from_mount = feet_body - robot.mount_positions_body
    x, y, z = from_mount[..., 0], from_mount[..., 1], from_mount[..., 2]
    outward, up = np.sqrt(x * x + y * y) - leg.coxa_outward_m, z - leg.coxa_up_m
    distance = np.sqrt(outward * outward + up * up)
    side = np.minimum(np.maximum(distance, leg.least_m), leg.most_m)
    square = side * side
    # The angles at the hip and at the knee, from their cosines.
    angles = np.empty((2, *x.shape))
    np.divide(leg.femur_square + square - leg.tibia_square, leg.twice_femur * side, out=angles[0])
    np.divide(leg.sum_of_squares - square, leg.twice_product, out=angles[1])
    at_hip, at_knee = np.arccos(_cosine(angles), out=angles)
    femur_up = np.arctan2(up, outward) + at_hip
    tibia_up = femur_up + at_knee - _HALF_TURN

    joints = np.empty((*x.shape, JOINTS_PER_LEG))
    np.subtract(np.arctan2(y, x), robot.mount_yaws_rad, out=joints[..., 0])
    np.subtract(femur_up, leg.femur_slope_rad, out=joints[..., 1])
    np.subtract(tibia_up - leg.tibia_slope_rad, joints[..., 1], out=joints[..., 2])
    return _wrapped(joints).reshape(*x.shape[:-1], N_JOINTS), side, distance


def _cosine(value: FloatArray) -> FloatArray:
    """The value within [-1, 1]; `np.clip` takes three times as long."""
    cosine: FloatArray = np.minimum(np.maximum(value, _LEAST_COSINE), _MOST_COSINE)
    return cosine


def _wrapped(angle_rad: FloatArray) -> FloatArray:
    wrapped: FloatArray = angle_rad - _TURN * np.rint(angle_rad / _TURN)
    return wrapped


#: Rounding of the stance itself must not count as out of range.
TOLERANCE_RAD = 1e-9


def solve_legs_within_limits(robot: Robot, feet_body: FloatArray) -> FloatArray:
    """Joint angles, leading shape + (18,), of feet; raises ReachError or LimitError, naming leg and joint."""
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
    """Distance of each joint from its range, negative inside, in the shape of the angles."""
    return np.maximum(
        robot.joint_lower_rad - joint_positions_rad, joint_positions_rad - robot.joint_upper_rad
    )


def legs_that_reach(robot: Robot, feet_body: FloatArray) -> BoolArray:
    """Whether each leg reaches its foot within its joint ranges, (..., 6), of feet in m, (..., 6, 3)."""
    solution = solve_legs(robot, feet_body)
    outside = range_excess_rad(robot, solution.joint_positions_rad) > TOLERANCE_RAD
    return np.asarray(solution.reachable & ~by_leg(outside).any(axis=-1))


def _reach_message(robot: Robot, feet_body: FloatArray, leg_index: int) -> str:
    coxa, femur, tibia = (tuple(vector) for vector in robot.link_vectors_m.tolist())
    from_mount = feet_body[..., leg_index, :].reshape(-1, 3) - robot.mount_positions_body[leg_index]
    distance = np.hypot(np.hypot(from_mount[:, 0], from_mount[:, 1]) - coxa[0], from_mount[:, 2] - coxa[1])
    least, most = leg_reach_m(femur, tibia)
    worst = distance[np.maximum(least - distance, distance - most).argmax()]
    return (
        f"leg {leg_index + 1}: foot {worst:.4f} m from its femur joint; allowed: {least:.4f} to {most:.4f} m"
    )


def joint_angles_of_feet(robot: Robot, feet_body: ArrayLike) -> FloatArray:
    """Joint angles that put the feet at positions in the body frame (inverse kinematics).

        feet = hexctl.feet_of_joint_angles(robot, robot.stance_angles_rad)
        feet[4] += [0.0, 0.0, 0.03]  # lift the foot of leg 5 by 3 cm
        angles_rad = hexctl.joint_angles_of_feet(robot, feet)

    Of the two solutions of a leg, it is the one with the knee up.

    Args:
        robot: whose legs.
        feet_body: centres of the feet of legs 1 to 6 in m, leading shape + (6, 3). The body frame has x
            forward, y left and z up.

    Returns:
        Angles in rad, leading shape + (18,): coxa, femur and tibia of leg 1, then of leg 2, and so on.

    Raises:
        ReachError: a foot is out of reach. The message names the leg and the allowed distances.
        LimitError: a joint would leave its range. The message names the leg, the joint and the range.
        InputError: the positions have another shape or are not finite.
        WrongTypeError: an argument has a wrong type.
    """
    check_type(robot, Robot, "robot", "a Robot, as load_robot('ant') gives")
    return solve_legs_within_limits(robot, as_numbers(feet_body, (N_LEGS, 3), "feet_body"))


def feet_of_joint_angles(robot: Robot, joint_positions_rad: ArrayLike) -> FloatArray:
    """Positions of the feet in the body frame at joint angles (forward kinematics).

    Args:
        robot: whose legs.
        joint_positions_rad: angles in rad, leading shape + (18,), in the order that `joint_angles_of_feet`
            returns. They may be outside the ranges of the joints.

    Returns:
        Centres of the feet of legs 1 to 6 in m, leading shape + (6, 3).

    Raises:
        InputError: there are not 18 angles, or they are not finite.
        WrongTypeError: an argument has a wrong type.
    """
    check_type(robot, Robot, "robot", "a Robot, as load_robot('ant') gives")
    angles_rad = as_joint_angles(joint_positions_rad, "joint_positions_rad")
    check_finite(angles_rad, angles_rad.shape, "joint_positions_rad")
    return foot_positions_body(robot, angles_rad)
