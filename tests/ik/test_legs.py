"""Kinematics both ways: there and back, out of reach, and as programs call them.

Against MuJoCo, `tests/robot/test_formats.py` compares feet and knees with those of our URDF.
"""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hexctl
from hexctl.errors import LimitError, ReachError, WrongTypeError
from hexctl.ik.legs import (
    check_joint_limits,
    foot_positions_body,
    link_points_body,
    solve_legs,
    solve_legs_within_limits,
)
from hexctl.robot.model import Robot
from hexctl.types import JOINT_KINDS, N_JOINTS, N_LEGS, BoolArray, FloatArray
from tests.robots import ROBOT_NAMES, shipped

names = st.sampled_from(ROBOT_NAMES)
eighteen = st.lists(st.floats(0, 1), min_size=N_JOINTS, max_size=N_JOINTS).map(np.array)


def _angles_within_limits(robot: Robot, shares: FloatArray) -> FloatArray:
    span = robot.joint_upper_rad - robot.joint_lower_rad
    angles: FloatArray = robot.joint_lower_rad + shares * span
    return angles


def _feet_around(robot: Robot, shares: FloatArray) -> FloatArray:
    """Feet all around the mounts, some of them out of reach."""
    reach = float(np.hypot(*robot.link_vectors_m.T).sum())
    return robot.mount_positions_body + (2 * shares.reshape(N_LEGS, 3) - 1) * reach


def _foot_before_the_coxa(robot: Robot, angles: FloatArray) -> BoolArray:
    """Whether each foot is on the side of the coxa axis to which its leg points."""
    points = link_points_body(robot, angles)
    yaw = robot.mount_yaws_rad + angles[::3]
    outward = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    return np.asarray(((points[:, 3] - points[:, 0])[:, :2] * outward).sum(axis=-1) > 1e-3)


def _knee_up(robot: Robot, angles: FloatArray) -> BoolArray:
    """Whether each knee is above the line from the femur joint to the foot."""
    slopes = np.arctan2(robot.link_vectors_m[:, 1], robot.link_vectors_m[:, 0])
    return np.asarray(np.sin(angles[2::3] + slopes[2] - slopes[1]) < -1e-3)


@given(name=names, shares=eighteen)
def test_feet_that_can_be_reached_come_back_from_their_angles(name: str, shares: FloatArray) -> None:
    robot = shipped(name)
    feet = _feet_around(robot, shares)
    solution = solve_legs(robot, feet)
    back = foot_positions_body(robot, solution.joint_positions_rad)
    reachable = solution.reachable
    np.testing.assert_allclose(back[reachable], feet[reachable], atol=1e-7)
    off = np.linalg.norm(back - feet, axis=-1)
    assert (off[~reachable] > 0).all(), "a foot that can be put in place is reachable"


@given(name=names, shares=eighteen)
def test_angles_come_back_from_their_feet(name: str, shares: FloatArray) -> None:
    robot = shipped(name)
    angles = _angles_within_limits(robot, shares)
    feet = foot_positions_body(robot, angles)
    solution = solve_legs(robot, feet)
    before = _foot_before_the_coxa(robot, angles)
    back = foot_positions_body(robot, solution.joint_positions_rad)
    np.testing.assert_allclose(back[before], feet[before], atol=1e-6)
    same = np.repeat(before & _knee_up(robot, angles), 3)
    np.testing.assert_allclose(solution.joint_positions_rad[same], angles[same], atol=1e-6)


@given(name=names, shares=eighteen)
def test_a_foot_out_of_reach_is_flagged_and_the_leg_points_at_it(name: str, shares: FloatArray) -> None:
    robot = shipped(name)
    feet = robot.mount_positions_body + 5 * (_feet_around(robot, shares) - robot.mount_positions_body)
    solution = solve_legs(robot, feet)
    assert np.isfinite(solution.joint_positions_rad).all()
    femur, tibia = np.hypot(*robot.link_vectors_m[1:].T)
    points = link_points_body(robot, solution.joint_positions_rad)
    to_foot, to_wanted = points[:, 3] - points[:, 1], feet - points[:, 1]
    distance = np.linalg.norm(to_wanted, axis=-1)
    beyond = distance > femur + tibia + 1e-9
    assert not solution.reachable[beyond].any()
    np.testing.assert_allclose(np.linalg.norm(to_foot[beyond], axis=-1), femur + tibia, atol=1e-9)
    cosine = (to_foot * to_wanted).sum(axis=-1) / np.linalg.norm(to_foot, axis=-1) / distance
    np.testing.assert_allclose(cosine[beyond], 1, atol=1e-9)


@pytest.mark.parametrize("where", ["coxa axis", "femur joint", "mount"])
def test_a_foot_too_near_is_flagged_and_finite(where: str) -> None:
    robot = shipped()
    points = link_points_body(robot, robot.stance_angles_rad)
    feet = {
        "coxa axis": points[:, 0] + [0, 0, -0.001],
        "femur joint": points[:, 1],
        "mount": robot.mount_positions_body,
    }[where]
    solution = solve_legs(robot, feet)
    assert np.isfinite(solution.joint_positions_rad).all()
    assert where != "femur joint" or not solution.reachable.any()


def test_many_poses_at_once_equal_each_alone_to_the_last_bit() -> None:
    robot = shipped("phantomx")
    shares = np.random.default_rng(3).uniform(size=(4, 5, N_JOINTS))
    angles = _angles_within_limits(robot, shares)
    feet = foot_positions_body(robot, angles)
    together = solve_legs(robot, feet)
    for index in np.ndindex(4, 5):
        alone = solve_legs(robot, feet[index])
        assert np.array_equal(together.joint_positions_rad[index], alone.joint_positions_rad)
        assert np.array_equal(together.reachable[index], alone.reachable)
        assert np.array_equal(feet[index], foot_positions_body(robot, angles[index]))


@pytest.mark.parametrize("leg", [1, 3, 6])
def test_a_foot_out_of_reach_names_its_leg_and_how_far_it_may_be(leg: int) -> None:
    robot = shipped()
    feet = np.tile(robot.stance_feet_body, (5, 1, 1))
    feet[3, leg - 1] *= 1.5
    feet[4, leg - 1] *= 2.0
    hip = np.array([0.080 + 0.0503, -0.0112])
    worst_m = np.hypot(*(np.array([0.408, -0.242]) - hip))
    with pytest.raises(ReachError, match=f"leg {leg}: foot {worst_m:.4f} m.*0.0441 to 0.1889 m"):
        solve_legs_within_limits(robot, feet)


@pytest.mark.parametrize(
    ("leg", "kind", "side"), [(1, "coxa", -1), (4, "femur", 1), (6, "tibia", -1), (2, "tibia", 1)]
)
def test_a_joint_out_of_range_is_named_with_its_angle_and_range(leg: int, kind: str, side: int) -> None:
    robot = shipped("pexod")
    joint = 3 * (leg - 1) + JOINT_KINDS.index(kind)
    limits = robot.joint_lower_rad if side < 0 else robot.joint_upper_rad
    angles = np.tile(robot.stance_angles_rad, (4, 1))
    angles[1, joint], angles[2, joint] = limits[joint] + side * np.radians((1, 3))
    degrees, most = np.degrees(angles[2, joint]), 90 if kind == "coxa" else 45
    with pytest.raises(LimitError, match=f"leg {leg} {kind}: needs {degrees:.1f} .*-{most} to {most} deg"):
        check_joint_limits(robot, angles)


# As programs call them.

#: The functions without their types, for what a type checker would refuse as well.
api: Any = hexctl


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        *(("feet_body", wrong) for wrong in ("far", [[0.1, 0.2], [0.3]], np.zeros(3), 0.1)),
        *(("feet_body", wrong) for wrong in (np.zeros((5, 3)), np.full((6, 3), np.nan))),
        *(("joint_positions_rad", wrong) for wrong in (None, np.zeros(17), np.zeros((18, 2)), 0.4)),
        ("joint_positions_rad", [0.0] * 17 + [np.inf]),
    ],
)
def test_wrong_arguments_are_refused_by_name(name: str, wrong: Any) -> None:
    call = api.joint_angles_of_feet if name == "feet_body" else api.feet_of_joint_angles
    with pytest.raises(hexctl.InputError, match=f"^{name}"):
        call(shipped(), wrong)
    with pytest.raises(WrongTypeError, match=r"^robot"):
        call("ant", wrong)
