"""Masses of descriptions are those of the simulation."""

import numpy as np
import pytest
from dm_control import mjcf

from hexctl.backends.sim.simulation_model import make_body
from hexctl.robot.formats.link_masses import link_mass, trunk_mass
from tests.robots import ROBOT_NAMES, shipped


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_masses_are_those_of_the_simulated_robot(name: str) -> None:
    robot = shipped(name)
    model = mjcf.Physics.from_mjcf_model(make_body(robot)).model
    parts = [trunk_mass(robot.body), *(link_mass(robot, index) for index in range(3))]
    for place, part in zip(("trunk", "leg1/coxa", "leg1/femur", "leg1/tibia"), parts, strict=True):
        body = model.name2id(place, "body")
        assert part.mass_kg == pytest.approx(model.body_mass[body], rel=1e-12)
        assert part.com_m == pytest.approx(model.body_ipos[body], abs=1e-12)
        # MuJoCo sorts the principal moments.
        assert sorted(part.moments_kg_m2) == pytest.approx(sorted(model.body_inertia[body]), rel=1e-9)


def test_a_tilted_link_is_hardest_to_turn_across_its_length() -> None:
    mass = link_mass(shipped("phantomx"), 2)
    along = np.array([np.sin(mass.tilt_rad), 0.0, np.cos(mass.tilt_rad)])
    outward, up = shipped("phantomx").link_vectors_m[2]
    assert along == pytest.approx(np.array([outward, 0.0, up]) / np.hypot(outward, up))
    assert mass.moments_kg_m2[2] < mass.moments_kg_m2[0] == mass.moments_kg_m2[1]
