"""Leg odometry as states come: as all at once, and what tells no motion."""

import numpy as np
import pytest

from hexctl.ik.leg_odometer import GAP_S, LegOdometer
from hexctl.ik.leg_odometry import leg_motions
from hexctl.robot.failure import Failure
from tests.driven import Command, driven
from tests.robots import shipped

AHEAD: tuple[Command, ...] = ((1, 0, 0, 0), (8, 1, 0, 0))
STANCE = shipped().stance_angles_rad


@pytest.mark.slow
def test_state_by_state_is_as_all_at_once() -> None:
    walk = driven("ant", AHEAD)
    odometer = LegOdometer(shipped())
    each = [odometer.update(at_s, angles) for at_s, angles in zip(walk.times_s, walk.joints_rad, strict=True)]
    assert each[0] is None
    together = leg_motions(shipped(), walk.times_s, walk.joints_rad)
    motions = [one.motion for one in each if one is not None and one.motion is not None]
    assert np.array(motions) == pytest.approx(together.motions, abs=1e-9)
    heights_m = [(one.height_m - one.rise_m, one.height_m) for one in each if one is not None]
    assert np.array(heights_m)[:, 1] == pytest.approx(together.height_m[1:], abs=1e-9)
    assert np.array(heights_m)[:, 0] == pytest.approx(together.height_m[:-1], abs=1e-9)


@pytest.mark.parametrize("at_s", [1.0, 0.9])
def test_a_state_that_is_no_later_is_left_out(at_s: float) -> None:
    odometer = LegOdometer(shipped())
    assert odometer.update(1.0, STANCE) is None
    assert odometer.update(at_s, STANCE) is None
    step = odometer.update(1.02, STANCE)
    assert step is not None
    assert (step.from_s, step.to_s) == (1.0, 1.02)


def test_angles_that_are_not_finite_are_left_out() -> None:
    odometer = LegOdometer(shipped())
    odometer.update(1.0, STANCE)
    assert odometer.update(1.02, np.full(18, np.nan)) is None
    step = odometer.update(1.04, STANCE)
    assert step is not None
    assert step.from_s == 1.0


def test_after_a_gap_the_height_is_known_and_the_motion_is_not() -> None:
    odometer = LegOdometer(shipped())
    odometer.update(1.0, STANCE)
    step = odometer.update(1.0 + GAP_S, STANCE)
    assert step is not None
    assert step.motion is None
    assert step.height_m == pytest.approx(shipped().standing_height_m, abs=0.002)
    step = odometer.update(1.02 + GAP_S, STANCE)
    assert step is not None
    assert step.motion == pytest.approx(np.zeros(3), abs=1e-9)


@pytest.mark.slow
def test_legs_that_are_told_and_one_that_is_noticed_are_left_out() -> None:
    walk = driven("pexod", AHEAD, failure=Failure(leg=2, kind="missing"), told=False)
    odometer = LegOdometer(shipped("pexod"))
    odometer.told = (5,)
    assert odometer.lost_legs == (5,)
    odometer.told = ()
    for at_s, angles, pose in zip(walk.times_s, walk.joints_rad, walk.poses, strict=True):
        odometer.update(at_s, angles)
        odometer.see(at_s, pose)
    assert odometer.lost_legs == (2,)
