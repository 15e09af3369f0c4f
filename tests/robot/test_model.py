"""The robot model: read-only, comparable, and refused where its arrays are no robot's."""

import math
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.errors import InputError
from hexctl.robot.loader import load_robot
from hexctl.robot.schema import Body, even_box_m
from tests.robots import edited_file, put, shipped

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
            with pytest.raises(InputError, match="inertia_kg_m2"):
                Body(shape="box", size_m=(0.1, 0.1, 0.1), mass_kg=mass_kg, inertia_kg_m2=moments)
        return
    x, y, z = np.square(even_box_m(mass_kg, moments))
    np.testing.assert_allclose(mass_kg / 12 * np.array([y + z, x + z, x + y]), moments, rtol=1e-9)


def test_a_trunk_that_cannot_be_is_refused() -> None:
    for key, value in (("mass_kg", math.nan), ("shape", "ball"), ("size_m", (0.1, 0.1)), ("mas_kg", 1.0)):
        with pytest.raises(InputError, match=f"body: .*{key}"):
            Body(**{"size_m": (0.1, 0.1, 0.1), "mass_kg": 1.0, key: value})  # type: ignore[arg-type]
    with pytest.raises(InputError, match="inertia_kg_m2"):
        replace(shipped().body, inertia_kg_m2=(1e-3, 1e-3, 3e-3))


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
    ("field", "value"),
    [
        ("name", 3),
        ("size_m", "1"),
        ("gait", "tripod"),
        ("link_radii_m", [0.01] * 3),
        ("stance_angles_rad", np.zeros((6, 3))),
        ("link_masses_kg", np.array([1.0, np.nan, 1.0])),
        ("link_masses_kg", np.array(["1", "1", "1"])),
    ],
)
def test_a_value_of_a_wrong_type_or_shape_is_refused(field: str, value: Any) -> None:
    with pytest.raises(InputError, match=f"robot.{field}"):
        replace(shipped(), **{field: value})
