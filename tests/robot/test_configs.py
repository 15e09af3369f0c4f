"""Shipped configuration files load, and robots of vendors move as the vendors' programs move them."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hexctl.backends.registry import raw_map_of
from hexctl.backends.sim.world import load_world
from hexctl.control.checks.feasibility import check_robot
from hexctl.errors import InputError
from hexctl.ik.legs import foot_positions_body
from hexctl.robot.configs import config_names, find_config, read_mapping, shipped_text
from hexctl.robot.failure import Failure
from hexctl.robot.loader import load_robot, load_robot_file
from hexctl.types import JOINTS_PER_LEG, FloatArray
from tests.robots import VENDORS_ROBOTS, shipped
from tests.trials import walk


@pytest.mark.parametrize("name", config_names("worlds"))
def test_every_shipped_world_loads(name: str) -> None:
    family = "ranges" in read_mapping(find_config("worlds", name))
    assert load_world(f"{name}:3" if family else name).friction > 0


def test_a_shipped_name_is_stored_in_one_spelling() -> None:
    texts = {"Randomized:07": "randomised:7", "randomised:7": "randomised:7", "FLAT": "flat", "flat": "flat"}
    others = ("world.yaml", "./Flat", "family.yaml:7", "nowhere", "nowhere:3", "randomised:x")
    for text, stored in {**texts, **dict(zip(others, others, strict=True))}.items():
        assert shipped_text("worlds", text) == stored
    assert shipped_text("robots", "ANT") == "ant"


#: Legs 1 to 3 are on the left.
LEFT = np.repeat([True, True, True, False, False, False], JOINTS_PER_LEG)


def _angles(name: str, shares: list[float]) -> FloatArray:
    """Joint angles at shares of each joint's range."""
    robot = shipped(name)
    return robot.joint_lower_rad + np.tile(shares, 6) * (robot.joint_upper_rad - robot.joint_lower_rad)


def _feet_of_legs(name: str, angles_rad: FloatArray) -> FloatArray:
    """Feet as each leg's coxa axis sees them, (6, 3): outward, counter-clockwise of it, up."""
    robot = shipped(name)
    from_mount = foot_positions_body(robot, angles_rad) - robot.mount_positions_body
    cos, sin = np.cos(robot.mount_yaws_rad), np.sin(robot.mount_yaws_rad)
    x, y, up = from_mount.T
    return np.stack([cos * x + sin * y, -sin * x + cos * y, up], axis=-1)


inner = st.lists(st.floats(0.1, 0.9), min_size=3, max_size=3)


@settings(max_examples=30, deadline=None)
@given(inner)
def test_freenove_gets_the_pulses_of_its_own_inverse_kinematics(shares: list[float]) -> None:
    """Its servo angles: 90 - yaw; 90 - b and c on the right, 90 + b and 180 - c on the left."""
    angles_rad = _angles("freenove-big", shares)
    pulses = raw_map_of(load_robot_file("freenove-big")).raw(angles_rad).reshape(6, 3)
    for leg, (outward, aside, up) in enumerate(1000 * _feet_of_legs("freenove-big", angles_rad)):
        turned_deg = math.degrees(math.pi / 2 - math.atan2(aside, outward))
        reach = math.hypot(outward, aside) - 33
        assume(reach > 5)  # below or behind the coxa the vendor's arcsine has another branch
        length = math.hypot(reach, up)
        dips = math.asin(-up / length) - math.acos((90**2 + length**2 - 110**2) / (2 * 90 * length))
        bend = math.pi - math.acos((90**2 + 110**2 - length**2) / (2 * 90 * 110))
        dips_deg, bend_deg = math.degrees(dips), math.degrees(bend)
        left = leg < 3
        servo_deg = [
            turned_deg,
            90 + dips_deg if left else 90 - dips_deg,
            180 - bend_deg if left else bend_deg,
        ]
        np.testing.assert_allclose(pulses[leg], 500 + np.array(servo_deg) * 2000 / 180, atol=0.5)


@settings(max_examples=30, deadline=None)
@given(inner)
def test_phantomx_ax_gets_the_counts_of_its_own_inverse_kinematics(shares: list[float]) -> None:
    """Coxae count rearward and are turned on the right; femurs count downward, tibiae from 136.3 degrees."""
    angles_rad = _angles("phantomx-ax", shares)
    counts = raw_map_of(load_robot_file("phantomx-ax")).raw(angles_rad)
    degrees = np.degrees(angles_rad).reshape(6, 3)
    rearward = np.where([True] * 3 + [False] * 3, degrees[:, 0], -degrees[:, 0])
    femur = -degrees[:, 1] - 3.5
    tibia = (180 + degrees[:, 2]) - (90 + 46.3)
    told = np.stack([rearward, femur, tibia], axis=-1).ravel()
    turned = np.where(np.tile([False, False, True], 6), LEFT, ~LEFT)
    np.testing.assert_allclose(counts, 512 + np.where(turned, -told, told) * 1280 / 375, atol=1.0)


def test_jethexa_stands_as_its_description_says_with_centred_servos() -> None:
    feet = _feet_of_legs("jethexa", np.zeros(18))
    bent = math.radians(85)
    reach = 0.04505 + 0.07703 + 0.123 * math.cos(bent)
    np.testing.assert_allclose(feet, np.tile([reach, 0, -0.123 * math.sin(bent)], (6, 1)), atol=1e-4)
    np.testing.assert_array_equal(raw_map_of(load_robot_file("jethexa")).raw(np.zeros(18)), 500)


@pytest.mark.parametrize("name", VENDORS_ROBOTS)
def test_each_is_possible_fits_its_servos_and_says_what_to_measure(name: str) -> None:
    report = check_robot(name).to_dict()
    assert report["possible"]
    assert not report["doubtful"]
    assert report["warnings"] == []
    unit = "pulses" if name in ("makeyourpet", "freenove-big") else "counts"
    assert report[f"joints_beyond_{unit}"] == []
    assert report["to_measure"]
    assert report["driver"] == load_robot_file(name).content.servos.driver


@pytest.mark.long
@pytest.mark.parametrize("kind", ["locked", "limp"])
@pytest.mark.parametrize("name", VENDORS_ROBOTS)
def test_each_walks_without_any_of_its_legs(name: str, kind: str) -> None:
    for leg in range(1, 7):
        result = walk(robot=shipped(name), failure=Failure(leg=leg, kind=kind), duration_s=10).result
        assert result.status in ("ok", "no_progress"), leg  # it does not fall
        assert result.true_distance_m is not None
        assert result.true_distance_m > 0.3 * result.ideal_distance_m, leg


@pytest.mark.parametrize("text", ["<!-- of CAD -->\n<mujoco model='a: b'/>", "\ufeff<robot name='six'/>"])
def test_a_description_of_another_tool_is_to_be_imported(text: str, tmp_path: Path) -> None:
    (tmp_path / "some.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"hexctl robot import .*some\.yaml -o"):
        load_robot(tmp_path / "some.yaml")
