"""Values in other units than a robot file's are named with their unit and the converted value."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from hexctl import InputError
from hexctl.control.checks.feasibility import check_robot
from hexctl.robot.configs import config_names, find_config, read_mapping

KINDS = ("coxa", "femur", "tibia")
Content = dict[str, Any]


def times(section: str, keys: tuple[str, ...], factor: float) -> Callable[[Content], None]:
    """Edit that multiplies values of all kinds of joints or links."""

    def change(content: Content) -> None:
        for kind in KINDS:
            part = content[section][kind]
            for key in (key for key in keys if key in part):
                value = part[key]
                part[key] = [one * factor for one in value] if isinstance(value, list) else value * factor

    return change


def at(section: str, key: str, change: Callable[[Any], Any]) -> Callable[[Content], None]:
    """Edit of one value."""

    def edit(content: Content) -> None:
        content[section][key] = change(content[section][key])

    return edit


def speeds(change: Callable[[float], float]) -> Callable[[Content], None]:
    """Edit of the maximum speeds of all joints, without those without load."""

    def edit(content: Content) -> None:
        for kind in KINDS:
            joint = content["joints"][kind]
            joint.pop("no_load_speed_deg_s", None)
            joint["max_speed_deg_s"] = change(joint["max_speed_deg_s"])

    return edit


def mount_yaws_in_rad(content: Content) -> None:
    for mount in content["mounts"]:
        mount["yaw_deg"] = math.radians(mount["yaw_deg"])


def _thousandfold(size: list[float]) -> list[float]:
    return [1000 * one for one in size]


TORQUE = ("max_torque_nm", "dry_friction_nm")
RANGE = ("min_deg", "max_deg")
WRONG: dict[str, tuple[str, Callable[[Content], None], str]] = {
    "kg cm": ("freenove-big", times("joints", TORQUE, 1 / 0.0981), "in kg cm that is 1.3 N m"),
    "oz in": ("lukas", times("joints", TORQUE, 1 / 0.00706), "in oz in that is 2.94 N m"),
    "N cm": ("phantomx", times("joints", TORQUE, 100), "in N cm that is 1.5 N m"),
    "kg cm of a weak servo": ("ant", times("joints", TORQUE, 2), "in kg cm that is 0.491 N m"),
    "rpm": ("pexod", speeds(lambda value: value / 6), "in rpm that is 401 deg/s"),
    "rad/s": ("ant", speeds(math.radians), "in rad/s that is 450 deg/s"),
    "s/60 deg": ("lukas", speeds(lambda value: 60 / value), "in s/60 deg that is 200 deg/s"),
    "above 20 rad/s": ("ant", speeds(lambda value: 10 * value), "max_speed_deg_s: got 4.5e"),
    "g of links": ("lukas", times("links", ("mass_kg",), 1000), "in g that is 0.161, 0.143, 0.0327 kg"),
    "kg of another robot": (
        "ant",
        at("body", "mass_kg", lambda value: value / 100),
        "body.mass_kg: got 0.001",
    ),
    "mm of a body": (
        "pexod",
        at("body", "size_m", lambda size: [1000 * one for one in size]),
        "in mm that is 0.24 m",
    ),
    "cm of a foot": ("pexod", lambda content: content.update(foot_radius_m=2.5), "in cm that is 0.025 m"),
    "inches of links": ("ant", times("links", ("end_m",), 39.37), "in inches that is"),
    "rad of one joint": ("lukas", times("joints", RANGE, math.radians(1)), "in rad that is -34.9, 34.9"),
    "rad of mounts": ("phantomx", mount_yaws_in_rad, "in rad that is 45, 90, 135, -135, -90, -45 deg"),
    "ms": ("lukas", at("servo", "dead_time_s", lambda value: 1000 * value), "in ms that is 0.02 s"),
    "N m/deg": ("ant", at("servo", "stiffness_nm_per_rad", math.radians), "in N m/deg that is 15 N m/rad"),
    "g cm2": ("ant", at("servo", "rotor_inertia_kg_m2", lambda value: 1e7 * value), "in g cm2 that is 0.002"),
}


@pytest.mark.parametrize("unit", WRONG)
def test_a_wrong_unit_is_named_with_the_converted_value(unit: str, tmp_path: Path) -> None:
    name, edit, named = WRONG[unit]
    content = read_mapping(find_config("robots", name))
    edit(content)
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(content))
    try:
        found = "\n".join(check_robot(tmp_path / "mine.yaml").warnings)
    except InputError as error:
        found = str(error)
    assert named in found


@pytest.mark.parametrize("name", config_names("robots"))
def test_shipped_robots_are_not_doubted(name: str) -> None:
    assert check_robot(name).unit_doubts == ()


def test_a_robot_with_unknown_masses_may_carry_many_times_its_weight(tmp_path: Path) -> None:
    content = read_mapping(find_config("robots", "ant"))
    times("joints", TORQUE, 2)(content)
    content["unknown"].append("body.mass_kg")
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(content))
    assert check_robot(tmp_path / "mine.yaml").unit_doubts == ()
