"""The symmetries of the shipped robots."""

import math
from dataclasses import replace
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pytest

from hexctl.control.body_symmetry import IDENTITY, BodySymmetry, body_symmetries
from hexctl.robot.schema import Body
from tests.robots import ROBOT_NAMES, shipped


@cache
def symmetries(name: str) -> tuple[BodySymmetry, ...]:
    return body_symmetries(shipped(name))


@pytest.mark.parametrize(("name", "count"), [("ant", 12), ("phantomx", 4), ("pexod", 2)])
def test_a_robot_has_as_many_symmetries_as_its_drawing(name: str, count: int) -> None:
    found = symmetries(name)
    assert len(found) == count
    assert len(set(found)) == len(found)
    assert sum(symmetry.mirrored for symmetry in found) == len(found) // 2
    assert found[0] == IDENTITY
    keeping = [symmetry for symmetry in found if symmetry.keeps_heading]
    assert [symmetry.mirrored for symmetry in keeping] == [False, True], "left and right change places"


@pytest.mark.parametrize(
    ("mass", "count"),
    [
        ({"com_m": (0.0, 0.0, 0.02)}, 12),
        ({"com_m": (0.01, 0.0, 0.0)}, 2),  # only the mirror
        ({"com_m": (0.02, 0.006, 0.0)}, 1),
        ({"inertia_kg_m2": (1e-4, 1e-4, 1.5e-4)}, 12),
        ({"inertia_kg_m2": (1e-4, 1.5e-4, 1.5e-4)}, 4),
    ],
)
def test_a_centre_of_mass_off_the_axis_and_an_uneven_inertia_have_fewer_symmetries(
    mass: dict[str, Any], count: int
) -> None:
    body = Body(shape="cylinder", size_m=(0.16, 0.16, 0.03), mass_kg=0.1, **mass)
    assert len(body_symmetries(replace(shipped("ant"), body=body))) == count


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_symmetries_are_a_group(name: str) -> None:
    """One after another is a third, of legs, points, joints and headings alike; each has its inverse."""
    random = np.random.default_rng(5)
    points, angles_rad = random.normal(size=(4, 3)), random.normal(size=18)
    known = {one.legs: one for one in symmetries(name)}
    assert known[IDENTITY.legs] == IDENTITY
    for first, second in product(symmetries(name), repeat=2):
        both = known[tuple(second.legs[leg - 1] for leg in first.legs)]
        assert both.mirrored == (first.mirrored != second.mirrored)
        assert both.points(points) == pytest.approx(second.points(first.points(points)), abs=1e-7)
        assert both.joints(angles_rad).tolist() == second.joints(first.joints(angles_rad)).tolist()
        off_deg = both.heading_deg(20.0) - second.heading_deg(first.heading_deg(20.0))
        assert abs(math.remainder(off_deg, 360.0)) < 1e-5
    for one in symmetries(name):
        back = known[one.legs_before]
        assert back.points(one.points(points)) == pytest.approx(points, abs=1e-7)
        assert one.heading_before_deg(one.heading_deg(20.0)) == pytest.approx(20.0)
