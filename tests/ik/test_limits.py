"""Feet out of reach and joints out of range are refused with leg, joint, value and range."""

import numpy as np
import pytest

from hexctl.errors import LimitError, ReachError
from hexctl.ik.kinematics import foot_positions_body, solve_legs
from hexctl.ik.limits import check_joint_limits, solve_legs_within_limits
from hexctl.types import JOINT_KINDS, N_LEGS
from tests.robots import ROBOT_NAMES, shipped


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_the_stance_is_within_limits(name: str) -> None:
    robot = shipped(name)
    np.testing.assert_array_equal(
        solve_legs_within_limits(robot, robot.stance_feet_body),
        solve_legs(robot, robot.stance_feet_body).joint_positions_rad,
    )


@pytest.mark.parametrize("leg", range(1, N_LEGS + 1))
def test_a_foot_out_of_reach_names_its_leg_and_how_far_it_may_be(leg: int) -> None:
    robot = shipped()
    feet = np.tile(robot.stance_feet_body, (5, 1, 1))
    feet[3, leg - 1] *= 1.5
    feet[4, leg - 1] *= 2.0
    with pytest.raises(ReachError) as refused:
        solve_legs_within_limits(robot, feet)
    message = str(refused.value)
    hip = np.array([0.080 + 0.0503, -0.0112])
    distance = np.hypot(*(np.array([0.408, -0.242]) - hip))
    assert f"leg {leg}: foot {distance:.4f} m" in message, "the worst of its positions"
    assert "allowed: 0.0441 to 0.1889 m" in message
    assert "\n" not in message


@pytest.mark.parametrize("leg", range(1, N_LEGS + 1))
@pytest.mark.parametrize("kind", JOINT_KINDS)
@pytest.mark.parametrize("side", [-1, 1])
def test_a_joint_out_of_range_is_named_with_its_angle_and_range(leg: int, kind: str, side: int) -> None:
    robot = shipped("pexod")
    joint = 3 * (leg - 1) + JOINT_KINDS.index(kind)
    angles = robot.stance_angles_rad.copy()
    limits = robot.joint_lower_rad if side < 0 else robot.joint_upper_rad
    angles[joint] = limits[joint] + side * np.radians(3)
    degrees = np.degrees(angles[joint])
    with pytest.raises(LimitError, match=f"leg {leg} {kind}: needs {degrees:.1f} deg") as refused:
        check_joint_limits(robot, angles)
    most = 90 if kind == "coxa" else 45
    assert f"allowed: -{most} to {most} deg" in str(refused.value)


def test_the_worst_joint_of_many_poses_is_named() -> None:
    robot = shipped()
    angles = np.tile(robot.stance_angles_rad, (4, 1))
    angles[1, 3] = np.radians(61)
    angles[2, 10] = np.radians(95)
    with pytest.raises(LimitError, match=r"leg 4 femur: needs 95\.0 deg; allowed: -90 to 90 deg"):
        check_joint_limits(robot, angles)


def test_a_foot_that_only_a_joint_beyond_its_range_reaches_is_refused() -> None:
    robot = shipped()
    angles = robot.stance_angles_rad.copy()
    angles[6] = np.radians(70)
    with pytest.raises(LimitError, match=r"leg 3 coxa: needs 70\.0 deg; allowed: -60 to 60 deg"):
        solve_legs_within_limits(robot, foot_positions_body(robot, angles))


def test_the_end_of_the_range_itself_is_allowed() -> None:
    robot = shipped()
    check_joint_limits(robot, robot.joint_upper_rad)
    check_joint_limits(robot, np.stack([robot.joint_lower_rad, robot.joint_upper_rad]))
