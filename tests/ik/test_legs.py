"""Kinematics both ways: there and back, against a scalar reference, and against MuJoCo.

For the latter, chains are written by hand from the numbers of the robot files, without hexctl's own model.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
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


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_the_stance_of_the_file_is_the_solution_of_its_feet(name: str) -> None:
    robot = shipped(name)
    solution = solve_legs(robot, robot.stance_feet_body)
    assert solution.reachable.all()
    np.testing.assert_allclose(solution.joint_positions_rad, robot.stance_angles_rad, atol=1e-12)
    np.testing.assert_array_equal(
        solve_legs_within_limits(robot, robot.stance_feet_body), solution.joint_positions_rad
    )


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


# Against MuJoCo.

FILES = Path(__file__).parents[2] / "configs" / "robots"


def placed(mount: dict[str, Any]) -> tuple[list[float], float]:
    """Position of a mount and its yaw in degrees, from either of its two forms."""
    if "azimuth_deg" in mount:
        azimuth = math.radians(mount["azimuth_deg"])
        x, y = mount["radius_m"] * math.cos(azimuth), mount["radius_m"] * math.sin(azimuth)
        return [x, y, 0.0], mount["azimuth_deg"]
    return mount["position_m"], mount["yaw_deg"]


def leg_mjcf(number: int, mount: dict[str, Any], links: dict[str, Any]) -> str:
    """One leg: a vertical hinge, and two hinges whose positive angle lifts the link, in the leg's plane."""
    (x, y, z), yaw_deg = placed(mount)
    coxa, femur, tibia = (links[kind]["end_m"] for kind in ("coxa", "femur", "tibia"))
    weight = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
    return f"""
    <body name="coxa{number}" pos="{x!r} {y!r} {z!r}" euler="0 0 {yaw_deg!r}">{weight}
      <joint type="hinge" axis="0 0 1"/>
      <body name="femur{number}" pos="{coxa[0]!r} 0 {coxa[1]!r}">{weight}
        <joint type="hinge" axis="0 -1 0"/>
        <body name="tibia{number}" pos="{femur[0]!r} 0 {femur[1]!r}">{weight}
          <joint type="hinge" axis="0 -1 0"/>
          <site name="foot{number}" pos="{tibia[0]!r} 0 {tibia[1]!r}"/>
        </body>
      </body>
    </body>"""


class Chain:
    """A robot's legs on a fixed trunk in MuJoCo."""

    def __init__(self, name: str) -> None:
        import mujoco

        content = yaml.safe_load((FILES / f"{name}.yaml").read_text(encoding="utf-8"))
        legs = [
            leg_mjcf(number, mount, content["links"]) for number, mount in enumerate(content["mounts"], 1)
        ]
        text = f"<mujoco><compiler angle='degree'/><worldbody>{''.join(legs)}</worldbody></mujoco>"
        self._model = mujoco.MjModel.from_xml_string(text)
        self._data = mujoco.MjData(self._model)

    def points(self, joints_rad: FloatArray) -> FloatArray:
        """Coxa axis, femur joint, knee and foot of each leg, (6, 4, 3)."""
        import mujoco

        self._data.qpos[:] = joints_rad
        mujoco.mj_forward(self._model, self._data)
        return np.array(
            [
                [
                    *(self._data.body(f"{link}{leg}").xpos.copy() for link in ("coxa", "femur", "tibia")),
                    self._data.site(f"foot{leg}").xpos.copy(),
                ]
                for leg in range(1, 7)
            ]
        )


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_forward_kinematics_are_those_of_a_chain_built_by_hand(name: str) -> None:
    robot, chain = shipped(name), Chain(name)
    random = np.random.default_rng(1)
    for _ in range(30):
        joints_rad = random.uniform(robot.joint_lower_rad, robot.joint_upper_rad)
        np.testing.assert_allclose(link_points_body(robot, joints_rad), chain.points(joints_rad), atol=1e-12)
    np.testing.assert_allclose(
        foot_positions_body(robot, robot.stance_angles_rad),
        chain.points(robot.stance_angles_rad)[:, -1],
        atol=1e-12,
    )


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
