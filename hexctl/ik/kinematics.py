"""Kinematics for programs: joint angles of feet, and feet of joint angles, with checked arguments."""

from numpy.typing import ArrayLike

from hexctl.errors import check_type
from hexctl.ik.legs import foot_positions_body, solve_legs_within_limits
from hexctl.robot.model import Robot
from hexctl.types import N_LEGS, FloatArray, as_joint_angles, as_numbers, check_finite

#: Required type of a robot, for messages.
_A_ROBOT = "a Robot, as load_robot('ant') gives"


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
    check_type(robot, Robot, "robot", _A_ROBOT)
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
    check_type(robot, Robot, "robot", _A_ROBOT)
    angles_rad = as_joint_angles(joint_positions_rad, "joint_positions_rad")
    check_finite(angles_rad, angles_rad.shape, "joint_positions_rad")
    return foot_positions_body(robot, angles_rad)
