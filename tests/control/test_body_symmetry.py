"""The symmetries of the shipped robots."""

import math
from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest

from hexctl.control.body_symmetry import IDENTITY, BodySymmetry, body_symmetries
from hexctl.robot.schema import Body
from tests.robots import ROBOT_NAMES, shipped

HOW_MANY = {"ant": 12, "phantomx": 4, "pexod": 2}
LEGS = range(1, 7)


@cache
def symmetries(name: str) -> tuple[BodySymmetry, ...]:
    return body_symmetries(shipped(name))


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_a_robot_has_as_many_symmetries_as_its_drawing(name: str) -> None:
    found = symmetries(name)
    assert len(found) == HOW_MANY[name]
    assert len(set(found)) == len(found)
    assert sum(symmetry.mirrored for symmetry in found) == len(found) // 2
    assert found[0] == IDENTITY


WITH_MASS = [
    (Body(shape="cylinder", size_m=(0.16, 0.16, 0.03), mass_kg=0.1, com_m=(0.0, 0.0, 0.02)), 12),
    (Body(shape="cylinder", size_m=(0.16, 0.16, 0.03), mass_kg=0.1, com_m=(0.01, 0.0, 0.0)), 2),
    (Body(shape="cylinder", size_m=(0.16, 0.16, 0.03), mass_kg=0.1, com_m=(0.02, 0.006, 0.0)), 1),
    (Body(shape="cylinder", size_m=(0.16, 0.16, 0.03), mass_kg=0.1, inertia_kg_m2=(1e-4, 1e-4, 1.5e-4)), 12),
    (Body(shape="cylinder", size_m=(0.16, 0.16, 0.03), mass_kg=0.1, inertia_kg_m2=(1e-4, 1.5e-4, 1.5e-4)), 4),
]


@pytest.mark.parametrize(("body", "count"), WITH_MASS)
def test_a_centre_of_mass_off_the_axis_and_an_uneven_inertia_have_fewer_symmetries(
    body: Body, count: int
) -> None:
    """`ant` has 12; with its mass forward only the mirror is left, with it forward and left none."""
    assert len(body_symmetries(replace(shipped("ant"), body=body))) == count


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_left_and_right_change_places_in_every_robots_mirror(name: str) -> None:
    """Each robot is its own mirror image about its x axis: leg azimuths change their sign."""
    azimuths = shipped(name).leg_azimuths_rad
    (plain,) = [
        symmetry
        for symmetry in symmetries(name)
        if symmetry.mirrored
        and all(
            abs(math.remainder(azimuths[symmetry.legs[leg - 1] - 1] + azimuths[leg - 1], 2 * math.pi)) < 1e-6
            for leg in LEGS
        )
    ]
    assert plain.keeps_heading


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_only_that_mirror_and_the_identity_leave_forward_where_it_is(name: str) -> None:
    keeping = [symmetry for symmetry in symmetries(name) if symmetry.keeps_heading]
    assert [symmetry.mirrored for symmetry in keeping] == [False, True]
    assert keeping[0] == symmetries(name)[0]


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_a_turn_is_how_far_each_leg_comes(name: str) -> None:
    azimuths = shipped(name).leg_azimuths_rad
    for symmetry in symmetries(name):
        flip = -1 if symmetry.mirrored else 1
        for leg in LEGS:
            wanted = azimuths[symmetry.legs[leg - 1] - 1]
            off = math.remainder(
                flip * azimuths[leg - 1] + math.radians(symmetry.turn_deg) - wanted, 2 * math.pi
            )
            assert abs(off) < 1e-6


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
