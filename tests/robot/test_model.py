"""The robot model: read-only, comparable, and refused where its arrays are no robot's."""

import math
import pickle
from dataclasses import FrozenInstanceError, asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.errors import InputError
from hexctl.robot.loader import load_robot
from hexctl.robot.schema import Body, GaitDefaults
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


#: Fingerprints that shipped priors, repertoires and uncertainties name.
FINGERPRINTS = {
    "ant": "977850e5e368bbb671c6d1113073b5cd4e3155d5744d1e562ad93657ed6e6c28",
    "pexod": "03474e14803b036830878662745cd09400e0c374e30be028085a2f8d58fe84c5",
}


@pytest.mark.parametrize("name", FINGERPRINTS)
def test_keys_at_their_defaults_do_not_change_the_fingerprint(name: str, tmp_path: Path) -> None:
    assert shipped(name).fingerprint == FINGERPRINTS[name]
    spelled_out = edited_file(
        tmp_path,
        put("body", "com_m", [0.0, 0.0, 0.0]),
        put("joints", "coxa", "dry_friction_nm", 0),
        base=name,
    )
    assert load_robot(spelled_out).fingerprint == FINGERPRINTS[name]


OPTIONAL_KEYS = {
    "centre of mass": put("body", "com_m", [0.0, 0.0, 0.01]),
    "inertia": put("body", "inertia_kg_m2", [0.001, 0.001, 0.001]),
    "centre of mass of a link": put("links", "femur", "com_m", [0.03, 0.0]),
    "friction": put("joints", "coxa", "dry_friction_nm", 0.1),
    "stiffness": put("joints", "coxa", "stiffness_nm_per_rad", 9.0),
}


def test_each_optional_key_makes_another_robot(tmp_path: Path) -> None:
    robots = [load_robot(edited_file(tmp_path, edit)) for edit in OPTIONAL_KEYS.values()]
    assert len({robot.fingerprint for robot in [*robots, shipped()]}) == len(OPTIONAL_KEYS) + 1
    assert all(robot != shipped() for robot in robots)


@given(st.tuples(*[st.floats(1e-5, 0.1)] * 3), st.floats(0.05, 5))
def test_the_even_box_has_the_inertia_or_the_inertia_is_refused(
    moments: tuple[float, float, float], mass_kg: float
) -> None:
    possible = all(2 * own < sum(moments) * (1 - 1e-9) for own in moments)
    if not possible:
        if any(2 * own > sum(moments) * (1 + 1e-9) for own in moments):
            with pytest.raises(InputError, match="each below the sum of the other two"):
                Body(shape="box", size_m=(0.1, 0.1, 0.1), mass_kg=mass_kg, inertia_kg_m2=moments)
        return
    box = Body(shape="box", size_m=(0.1, 0.1, 0.1), mass_kg=mass_kg, inertia_kg_m2=moments).even_box_m
    assert box is not None
    x, y, z = np.square(box)
    np.testing.assert_allclose(mass_kg / 12 * np.array([y + z, x + z, x + y]), moments, rtol=1e-9)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"mass_kg": -1.0}, "body: mass_kg: got -1.0; allowed: above 0"),
        ({"mass_kg": math.nan}, "body: mass_kg: got nan; allowed: a finite number"),
        ({"mass_kg": True}, "body: mass_kg: got True; allowed: a number"),
        ({"shape": "ball"}, "body: shape: got 'ball'; allowed: 'box' or 'cylinder'"),
        ({"size_m": (0.1, 0.1)}, "body: size_m: got (0.1, 0.1); allowed: a longer list"),
        ({"size_m": 0.1}, "body: size_m: got 0.1; allowed: a list"),
        (
            {"inertia_kg_m2": (1e-3, 1e-3, 3e-3)},
            "body: inertia_kg_m2: got 0.001, 0.001, 0.003; ",
        ),
        ({"mas_kg": 1.0}, "body: unknown key mas_kg; did you mean 'mass_kg'?; allowed here: com_m, "),
    ],
)
def test_a_trunk_that_cannot_be_is_refused_in_one_line(values: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as refused:
        Body(**{"size_m": (0.1, 0.1, 0.1), "mass_kg": 1.0, **values})
    assert str(refused.value).startswith(message)


def test_a_changed_trunk_is_checked_as_well() -> None:
    with pytest.raises(InputError, match=r"^body: mass_kg: got 0"):
        replace(shipped().body, mass_kg=0.0)


def test_a_part_lacks_no_key() -> None:
    with pytest.raises(InputError, match=r"^body: mass_kg is missing; known here: com_m, "):
        Body(size_m=(0.1, 0.1, 0.1))  # type: ignore[call-arg]
    with pytest.raises(InputError, match=r"^gait: height is missing"):
        GaitDefaults(pace_hz=1.0, amplitude=0.1)  # type: ignore[call-arg]


@pytest.mark.parametrize("name", ["body", "servo", "gait"])
def test_a_part_travels_and_is_frozen(name: str) -> None:
    part = getattr(shipped("phantomx"), name)
    again = pickle.loads(pickle.dumps(part))  # noqa: S301
    assert again == part == replace(part) == type(part)(**asdict(part))
    assert repr(again) == repr(part)
    with pytest.raises(FrozenInstanceError):
        part.mass_kg = 1.0


def test_lists_of_a_part_are_tuples() -> None:
    body = Body(size_m=[1, 1, 1], mass_kg=1, inertia_kg_m2=[1, 1, 1])  # type: ignore[arg-type]
    assert (body.shape, body.size_m, body.inertia_kg_m2) == ("box", (1.0, 1.0, 1.0), (1.0, 1.0, 1.0))
    assert hash(body) == hash(replace(body))


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
