"""The load of a gait: torques over the cycle, and legs that come near one another."""

from dataclasses import replace

import numpy as np
import pytest

from hexctl.ik.clearance import PARTS
from tests.control.assessment.loads import changed, load_of, moved_back, moved_together
from tests.robots import shipped


def test_duties_are_of_joints_that_carry() -> None:
    strong = load_of(shipped("ant"))
    assert (strong.duties == 0).all()
    weak = load_of(changed("ant", torque=0.05))
    assert 0.5 < weak.duties[1::3].max() <= 1
    assert (weak.duties[0::3] == 0).all()


def test_legs_that_are_nearer_together_touch_then_cross_then_cross_longer() -> None:
    apart, touching, crossing, longer = (load_of(moved_together(share)) for share in (0.5, 0.4, 0.2, 0.05))
    assert apart.least_clearance_m > 0
    assert touching.least_clearance_m < 0
    assert touching.crossing_share == 0
    assert 0 < crossing.crossing_share < 0.25 < longer.crossing_share


def test_gap_and_depth_are_those_of_the_parts_that_are_named() -> None:
    """Thick coxae that overlap have a lesser gap than thin tibiae whose axes meet; these are named."""
    robot = replace(moved_together(0.2), link_radii_m=np.array([0.06, 0.015, 0.015]))
    load = load_of(robot)
    one, other = (PARTS.index(part) for part in load.nearest_parts)
    radii = np.append(robot.link_radii_m, robot.foot_radius_m)
    touching_m = radii[one] + radii[other]
    assert load.crossing
    assert "coxa" not in load.nearest_parts
    assert load.least_clearance_m == pytest.approx(-load.overlap * touching_m)


def test_a_robot_that_tips_over_has_finite_loads() -> None:
    load = load_of(moved_back(0.9))
    assert load.tipping == 1
    assert np.isfinite(load.torques_nm).all()
