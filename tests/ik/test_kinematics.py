"""Kinematics as programs call them: there and back, and refusals that name the leg or the argument."""

from typing import Any

import numpy as np
import pytest

import hexctl
from hexctl.errors import WrongTypeError
from tests.robots import ROBOT_NAMES, shipped

#: The functions without their types, for what a type checker would refuse as well.
api: Any = hexctl


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_feet_come_back_from_their_angles_for_one_pose_and_for_many(name: str) -> None:
    robot = shipped(name)
    stance = hexctl.feet_of_joint_angles(robot, robot.stance_angles_rad)
    np.testing.assert_allclose(stance, robot.stance_feet_body, atol=1e-12)
    np.testing.assert_allclose(
        hexctl.joint_angles_of_feet(robot, stance), robot.stance_angles_rad, rtol=0, atol=1e-9
    )
    moved = stance + np.array([[[0.01, 0.0, 0.0]], [[0.0, -0.008, 0.005]]])
    angles_rad = hexctl.joint_angles_of_feet(robot, moved)
    assert angles_rad.shape == (2, 18)
    np.testing.assert_allclose(hexctl.feet_of_joint_angles(robot, angles_rad), moved, atol=1e-9)


def test_only_the_leg_of_a_lifted_foot_moves() -> None:
    robot = shipped()
    feet = hexctl.feet_of_joint_angles(robot, robot.stance_angles_rad)
    feet[4] += [0.0, 0.0, 0.03]
    moved = np.abs(hexctl.joint_angles_of_feet(robot, feet.tolist()) - robot.stance_angles_rad) > 1e-9
    assert np.flatnonzero(moved).tolist() == [13, 14], "femur and tibia of leg 5"


def test_a_foot_out_of_reach_names_its_leg() -> None:
    robot = shipped()
    feet = robot.stance_feet_body.copy()
    feet[2, 0] -= 2.0
    with pytest.raises(hexctl.ReachError, match=r"^leg 3: .*allowed: "):
        hexctl.joint_angles_of_feet(robot, feet)


def test_a_joint_out_of_its_range_names_leg_and_joint() -> None:
    robot = shipped()
    angles_rad = robot.stance_angles_rad.copy()
    angles_rad[15] = robot.joint_upper_rad[15] + 0.3  # coxa of leg 6
    with pytest.raises(hexctl.LimitError, match=r"^leg 6 coxa: "):
        hexctl.joint_angles_of_feet(robot, hexctl.feet_of_joint_angles(robot, angles_rad))


@pytest.mark.parametrize(
    ("call", "answer"),
    [
        (lambda robot: api.joint_angles_of_feet("ant", robot.stance_feet_body), "robot: got 'ant'"),
        (lambda robot: api.joint_angles_of_feet(robot, "far"), "feet_body: got 'far'"),
        (lambda robot: api.joint_angles_of_feet(robot, [[0.1, 0.2], [0.3]]), "feet_body: got "),
        (lambda robot: api.feet_of_joint_angles(robot, None), "joint_positions_rad: got None"),
    ],
    ids=["robot", "text", "rows of different lengths", "none"],
)
def test_a_wrong_type_is_refused_by_name(call: Any, answer: str) -> None:
    with pytest.raises(WrongTypeError, match=f"^{answer}"):
        call(shipped())


@pytest.mark.parametrize("feet", [np.zeros((5, 3)), np.zeros(3), 0.1, np.full((6, 3), np.nan)])
def test_feet_of_another_shape_or_without_numbers_are_refused(feet: Any) -> None:
    with pytest.raises(hexctl.InputError, match=r"^feet_body: got "):
        hexctl.joint_angles_of_feet(shipped(), feet)


@pytest.mark.parametrize("angles", [np.zeros(17), np.zeros((18, 2)), [0.0] * 17 + [np.inf], 0.4])
def test_other_than_18_finite_angles_are_refused(angles: Any) -> None:
    with pytest.raises(hexctl.InputError, match=r"^joint_positions_rad: "):
        hexctl.feet_of_joint_angles(shipped(), angles)
