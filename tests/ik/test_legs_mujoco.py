"""Kinematics against MuJoCo's, on chains written by hand from the numbers of the robot files.

Neither hexctl's robot model nor its builder of simulations is used for the chains: the file is read as plain
YAML, and the MJCF is text.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hexctl.ik.legs import foot_positions_body, link_points_body, solve_legs
from hexctl.types import FloatArray
from tests.robots import ROBOT_NAMES, shipped

mujoco = pytest.importorskip("mujoco", reason="needs the sim extra")

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
        content = yaml.safe_load((FILES / f"{name}.yaml").read_text(encoding="utf-8"))
        legs = [
            leg_mjcf(number, mount, content["links"]) for number, mount in enumerate(content["mounts"], 1)
        ]
        text = f"<mujoco><compiler angle='degree'/><worldbody>{''.join(legs)}</worldbody></mujoco>"
        self._model = mujoco.MjModel.from_xml_string(text)
        self._data = mujoco.MjData(self._model)

    def points(self, joints_rad: FloatArray) -> FloatArray:
        """Coxa axis, femur joint, knee and foot of each leg, (6, 4, 3)."""
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
    for _ in range(50):
        joints_rad = random.uniform(robot.joint_lower_rad, robot.joint_upper_rad)
        np.testing.assert_allclose(link_points_body(robot, joints_rad), chain.points(joints_rad), atol=1e-12)
    np.testing.assert_allclose(
        foot_positions_body(robot, robot.stance_angles_rad),
        chain.points(robot.stance_angles_rad)[:, -1],
        atol=1e-12,
    )


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_inverse_kinematics_put_the_feet_of_that_chain_where_they_are_wished(name: str) -> None:
    robot, chain = shipped(name), Chain(name)
    random = np.random.default_rng(2)
    for _ in range(50):
        feet_body = robot.stance_feet_body + random.uniform(-0.03, 0.03, (6, 3))
        solution = solve_legs(robot, feet_body)
        reached = chain.points(solution.joint_positions_rad)[:, -1]
        np.testing.assert_allclose(reached[solution.reachable], feet_body[solution.reachable], atol=1e-9)
        assert solution.reachable.mean() > 0.5
