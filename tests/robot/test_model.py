"""The robot model: read-only, comparable, and refused where its arrays are no robot's."""

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.errors import InputError
from hexctl.robot.loader import load_robot
from hexctl.types import N_JOINTS
from tests.robots import ROBOT_NAMES, edited_file, put, shipped


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_a_robot_cannot_be_changed_by_accident(name: str) -> None:
    robot = shipped(name)
    with pytest.raises(ValueError, match="read-only"):
        robot.stance_angles_rad[0] = 1.0
    assert robot.stance_angles_rad.shape == (N_JOINTS,)


def test_equal_descriptions_have_equal_fingerprints(tmp_path: Path) -> None:
    assert load_robot("ant").fingerprint == load_robot("ant").fingerprint
    other = load_robot(edited_file(tmp_path, put("body", "mass_kg", 0.11)))
    assert other.fingerprint != load_robot("ant").fingerprint


def test_a_robot_that_travelled_is_still_read_only() -> None:
    robot = pickle.loads(pickle.dumps(shipped("ant")))  # noqa: S301
    with pytest.raises(ValueError, match="read-only"):
        robot.stance_angles_rad[0] = 1.0
    assert robot.fingerprint == shipped("ant").fingerprint


def test_robots_are_equal_exactly_if_their_descriptions_are(tmp_path: Path) -> None:
    ant, again = load_robot("ant"), load_robot("ant")
    assert ant == again
    assert hash(ant) == hash(again)
    assert pickle.loads(pickle.dumps(ant)) == ant  # noqa: S301
    assert ant != load_robot("phantomx")
    assert ant != load_robot(edited_file(tmp_path, put("body", "mass_kg", 0.11)))
    assert ant != load_robot(edited_file(tmp_path, put("joints", "coxa", "max_deg", 41)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": 3}, r"robot.name: got 3 \(int\); allowed: text"),
        ({"size_m": "1"}, "robot.size_m: got '1' .*allowed: a number"),
        ({"gait": "tripod"}, "robot.gait: got 'tripod' .*allowed: a GaitDefaults"),
        (
            {"link_radii_m": [0.01] * 3},
            r"robot.link_radii_m: got .* \(list\); allowed: an array of shape \(3,\)",
        ),
        ({"stance_angles_rad": np.zeros((6, 3))}, r"got an array of shape \(6, 3\); allowed: shape \(18,\)"),
        (
            {"link_masses_kg": np.array([1.0, np.nan, 1.0])},
            "masses_kg: got nan; allowed: finite",
        ),
        (
            {"link_masses_kg": np.array(["1", "1", "1"])},
            "got an array of <U1; allowed: numbers",
        ),
    ],
)
def test_a_value_of_a_wrong_type_or_shape_is_refused_at_once(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(shipped(), **change)


def test_a_robot_prints_as_one_short_line() -> None:
    ant = shipped()
    assert repr(ant) == f"Robot('ant', mass_kg=1, fingerprint='{ant.fingerprint[:12]}')"
