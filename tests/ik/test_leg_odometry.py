"""Leg odometry: exact for feet that stay, and near for those of simulated walks."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.errors import InputError
from hexctl.ik.leg_odometry import leg_motions, standing
from hexctl.ik.legs import solve_legs
from hexctl.robot.failure import Failure
from hexctl.types import FloatArray
from tests.driven import Command, Driven, course, driven
from tests.robots import shipped

#: Feet that do not roll.
POINT_FEET = replace(shipped(), foot_radius_m=1e-9)

AHEAD: tuple[Command, ...] = ((1, 0, 0, 0), (8, 1, 0, 0))


def joints_of(feet_body: FloatArray) -> FloatArray:
    return solve_legs(POINT_FEET, feet_body).joint_positions_rad


@given(
    forward_m=st.floats(-0.02, 0.02),
    left_m=st.floats(-0.02, 0.02),
    yaw_rad=st.floats(-0.1, 0.1),
    up_m=st.floats(-0.01, 0.01),
)
def test_feet_that_stay_tell_the_motion(forward_m: float, left_m: float, yaw_rad: float, up_m: float) -> None:
    before = POINT_FEET.stance_feet_body
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    turned_back = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    after = (before - [forward_m, left_m, up_m]) @ turned_back
    moved = leg_motions(POINT_FEET, np.array([0.0, 0.1]), np.stack([joints_of(before), joints_of(after)]))
    assert moved.motions[0] == pytest.approx([forward_m, left_m, yaw_rad], abs=1e-6)
    assert np.diff(moved.height_m)[0] == pytest.approx(up_m, abs=1e-6)
    assert moved.slip_m[0] < 1e-6


def test_a_body_that_leans_knows_up_and_its_height() -> None:
    lean = np.radians(5.0)
    turn = np.array([[np.cos(lean), 0, np.sin(lean)], [0, 1, 0], [-np.sin(lean), 0, np.cos(lean)]])
    stands = standing(POINT_FEET, joints_of(POINT_FEET.stance_feet_body @ turn))
    assert stands.up_body == pytest.approx(np.array([0, 0, 1.0]) @ turn)
    assert stands.height_m == pytest.approx(POINT_FEET.standing_height_m, abs=1e-6)
    assert stands.above_m == pytest.approx(np.zeros(6), abs=1e-6)


def test_feet_in_the_air_do_not_count() -> None:
    before = POINT_FEET.stance_feet_body.copy()
    before[[0, 2, 4], 2] += 0.03
    after = before - [0.01, 0.0, 0.0]
    after[[0, 2, 4], 0] += 0.03
    moved = leg_motions(POINT_FEET, np.array([0.0, 0.1]), np.stack([joints_of(before), joints_of(after)]))
    assert moved.motions[0] == pytest.approx([0.01, 0, 0], abs=1e-5)


@pytest.mark.parametrize("slipping", range(6))
def test_one_foot_that_slips_is_outvoted(slipping: int) -> None:
    before, after = POINT_FEET.stance_feet_body, POINT_FEET.stance_feet_body - [0.002, 0.0, 0.0]
    after[slipping, 1] += 0.02
    moved = leg_motions(POINT_FEET, np.array([0.0, 0.02]), np.stack([joints_of(before), joints_of(after)]))
    assert moved.motions[0, :2] == pytest.approx([0.002, 0], abs=6e-4)
    assert abs(moved.motions[0, 2]) < 0.003


def errors_of(walk: Driven, motions: FloatArray) -> tuple[float, float]:
    """Error at the end as a share of the distance, and of the yaw in deg per m."""
    found, true = course(motions)[-1], course(walk.motions)[-1]
    distance_m = float(np.hypot(*true[:2]))
    return float(np.hypot(*(found - true)[:2])) / distance_m, abs(np.degrees(found - true)[2]) / distance_m


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "gait", "world", "most"),
    [
        ("ant", "tripod", "flat", 0.06),
        ("ant", "wave", "flat", 0.09),
        ("phantomx", "tripod", "flat", 0.06),
        ("pexod", "wave", "flat", 0.12),
        ("pexod", "tripod", "real:3", 0.25),
    ],
)
def test_walks_are_told_by_the_joints(robot: str, gait: str, world: str, most: float) -> None:
    walk = driven(robot, AHEAD, gait=gait, world=world)
    moved = leg_motions(shipped(robot), walk.times_s, walk.joints_rad)
    share, yaw_deg_per_m = errors_of(walk, moved.motions)
    assert share < most
    assert yaw_deg_per_m < 120 * most
    assert np.sqrt(np.mean(np.square(moved.height_m - walk.height_m))) < 0.0025


def test_known_contacts_make_it_better() -> None:
    walk = driven("pexod", AHEAD, world="real:3")
    moved = leg_motions(shipped("pexod"), walk.times_s, walk.joints_rad, walk.contacts)
    assert errors_of(walk, moved.motions)[0] < 0.08


@pytest.mark.parametrize("kind", ["locked", "missing"])
def test_a_failed_leg_does_not_hold_it_back(kind: str) -> None:
    walk = driven("ant", AHEAD, failure=Failure(leg=2, kind=kind))
    moved = leg_motions(shipped(), walk.times_s, walk.joints_rad)
    assert errors_of(walk, moved.motions)[0] < 0.12


def test_a_robot_that_stands_does_not_move() -> None:
    walk = driven("ant", ((2, 0, 0, 0),))
    assert np.abs(course(leg_motions(shipped(), walk.times_s, walk.joints_rad).motions)).max() < 1e-3


def test_what_cannot_be_is_refused() -> None:
    stance = np.tile(shipped().stance_angles_rad, (3, 1))
    for times_s in ([0.0], [0.0, 1.0, 1.0], [0.0, 1.0]):
        with pytest.raises(InputError, match="allowed"):
            leg_motions(shipped(), np.array(times_s), stance)


def test_a_leg_that_is_gone_carries_nothing() -> None:
    before = POINT_FEET.stance_feet_body.copy()
    before[1, 2] -= 0.02
    after = before - [0.002, 0.0, 0.0]
    after[1] += [0.02, 0.0, 0.0]
    joints = np.stack([joints_of(before), joints_of(after)])
    for contacts in (None, np.ones((2, 6), dtype=bool)):
        moved = leg_motions(POINT_FEET, np.array([0.0, 0.02]), joints, contacts, lost_legs=(2,))
        assert moved.motions[0] == pytest.approx([0.002, 0, 0], abs=1e-5)
        assert moved.height_m == pytest.approx([POINT_FEET.standing_height_m] * 2, abs=1e-5)
