"""The arena as geometry, the heading that returns home, and the fence around it."""

import math
from typing import get_args

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from hexctl.adapt.arena import Arena, Geofence, aimed, check_radius
from hexctl.control.trace import Trace, TrialFrame
from hexctl.control.trial_plan import SelfRotation
from hexctl.control.walks.turning import body_heading_rad, turn_needed_rad
from hexctl.errors import InputError, RobotFaultError
from hexctl.robot.failure import Failure
from hexctl.robot.rotations import about_z, wrapped_rad
from hexctl.types import FloatArray, RobotState
from tests.adapt.priors import plan_of
from tests.robots import shipped

RADII = st.floats(0.5, 20)

PLACES = st.floats(-50, 50)

ANGLES = st.floats(-math.pi, math.pi)

SHARES = st.floats(0, 1)


def at(arena: Arena, distance_m: float, angle_rad: float) -> FloatArray:
    """The position so far from home in a direction."""
    x, y = arena.home_m
    return np.array([x + distance_m * math.cos(angle_rad), y + distance_m * math.sin(angle_rad), 0.1])


def ahead(position: FloatArray, heading_rad: float, distance_m: float) -> FloatArray:
    return position + distance_m * np.array([math.cos(heading_rad), math.sin(heading_rad), 0.0])


def room_m_of(arena: Arena, position: FloatArray, heading_rad: float) -> float:
    """Length of a straight walk until it leaves the arena, 0 if it never enters."""
    x, y = position[:2] - arena.home_m
    along = x * math.cos(heading_rad) + y * math.sin(heading_rad)
    inside = along**2 - x**2 - y**2 + arena.radius_m**2
    return max(0.0, math.sqrt(inside) - along) if inside > 0 else 0.0


@given(RADII, PLACES, PLACES, SHARES, ANGLES, ANGLES)
def test_no_heading_has_more_room_than_the_one_it_aims(
    radius_m: float, x: float, y: float, share: float, angle_rad: float, other_rad: float
) -> None:
    arena = Arena(home_m=(x, y), radius_m=radius_m)
    position = at(arena, share * radius_m, angle_rad)
    room_m = room_m_of(arena, position, arena.aim_rad(position, 0.0))
    assert room_m >= room_m_of(arena, position, other_rad) - 0.11  # at home, anywhere will do
    assert room_m == pytest.approx(radius_m + share * radius_m, abs=0.11)


@given(RADII, PLACES, PLACES, SHARES, ANGLES, ANGLES)
def test_room_ends_on_the_edge(
    radius_m: float, x: float, y: float, share: float, angle_rad: float, heading_rad: float
) -> None:
    arena = Arena(home_m=(x, y), radius_m=radius_m)
    position = at(arena, 0.999 * share * radius_m, angle_rad)
    room_m = room_m_of(arena, position, heading_rad)
    assert arena.distance_m(ahead(position, heading_rad, room_m)) == pytest.approx(radius_m, abs=1e-6)
    assert not arena.leaves(position, ahead(position, heading_rad, 0.99 * room_m))
    assert arena.leaves(position, ahead(position, heading_rad, 1.01 * room_m + 1e-6))


@given(st.floats(1.01, 5), PLACES, PLACES, ANGLES)
def test_a_robot_outside_is_let_in_but_not_out(away: float, x: float, y: float, angle_rad: float) -> None:
    arena = Arena(home_m=(x, y), radius_m=2.0)
    position = at(arena, 2.0 * away, angle_rad)
    aim_rad = arena.aim_rad(position, 0.0)
    assert not arena.leaves(position, ahead(position, aim_rad, 0.3))
    assert arena.leaves(position, ahead(position, aim_rad + math.pi, 0.3))
    assert room_m_of(arena, position, aim_rad) == pytest.approx(2.0 * away + 2.0)
    assert room_m_of(arena, position, aim_rad + math.pi) == 0


@given(RADII, st.floats(0.5, 40), SHARES, ANGLES)
def test_a_start_has_room_for_the_walk_wherever_there_is_any(
    radius_m: float, reach_m: float, share: float, angle_rad: float
) -> None:
    arena = Arena(home_m=(1.0, -2.0), radius_m=radius_m)
    position = at(arena, share * radius_m, angle_rad)
    room_m = room_m_of(arena, position, arena.aim_rad(position, 0.0))
    if not arena.too_near(position, reach_m):
        assert room_m >= min(reach_m, 2 * radius_m) - 0.1 - 1e-9
    else:
        assert room_m < reach_m
        assume(2 * radius_m >= reach_m)
        started = at(arena, arena.start(reach_m).radius_m, angle_rad)
        assert room_m_of(arena, started, arena.aim_rad(started, 0.0)) >= reach_m - 1e-9


ROBOT = shipped()

ARENA = Arena(home_m=(0.5, -0.2), radius_m=3.0)

ROTATIONS = st.sampled_from(get_args(SelfRotation))


def standing(x: float, y: float, yaw_rad: float) -> RobotState:
    quaternion = np.array([math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2)])
    position = np.array([x, y, 0.1])
    return RobotState(
        ROBOT.stance_angles_rad, 0.0, True, base_position_world=position, base_quaternion_world=quaternion
    )


def apart_deg(one_rad: float, other_rad: float) -> float:
    return abs(math.degrees(wrapped_rad(one_rad - other_rad)))


@given(ROTATIONS, st.integers(1, 6), st.floats(-3, 3), st.floats(-3, 3), ANGLES, st.booleans())
def test_the_walk_leads_through_home_and_is_the_same_seen_from_the_body(
    self_rotation: SelfRotation, leg: int, x: float, y: float, yaw_rad: float, outward: bool
) -> None:
    plan = plan_of(ROBOT, failure=Failure(leg=leg), heading_rad=0.3, self_rotation=self_rotation)
    state = standing(x, y, yaw_rad)
    turned = aimed(plan, ROBOT, state, ARENA, outward=outward)
    seen_from_body = turned.motion(turn_needed_rad(ROBOT, turned)).heading_rad
    assert apart_deg(seen_from_body, body_heading_rad(ROBOT, plan)) < 1e-6
    assert abs(turn_needed_rad(ROBOT, turned)) <= math.pi + 1e-9
    if math.hypot(x - 0.5, y + 0.2) > 0.06:
        home_rad = math.atan2(-0.2 - y, 0.5 - x) + (math.pi if outward else 0.0)
        assert apart_deg(yaw_rad + turned.heading_rad, home_rad) < 1e-6


@given(ROTATIONS, ANGLES)
def test_at_home_nothing_turns(self_rotation: SelfRotation, yaw_rad: float) -> None:
    usual = plan_of(ROBOT, heading_rad=0.3, self_rotation=self_rotation)
    for outward in (False, True):
        plan = aimed(usual, ROBOT, standing(0.5, -0.2, yaw_rad), ARENA, outward=outward)
        assert turn_needed_rad(ROBOT, plan) == pytest.approx(0.0, abs=1e-9)


def test_a_robot_that_lost_its_pose_cannot_aim() -> None:
    with pytest.raises(RobotFaultError, match="no longer knows"):
        aimed(plan_of(ROBOT), ROBOT, RobotState(ROBOT.stance_angles_rad, 0.0, True), ARENA)


def walked(start_m: float, to_m: float, *, ticks: int = 100) -> Trace:
    """Trace of an even walk along x; NaN is a robot that does not know where it is."""
    trace = Trace()
    trace.frame = TrialFrame(np.array([start_m, 0.0, 0.1]), 0.0, 0.0)
    trace.begin_phase("walk")
    for tick, x_m in enumerate(np.linspace(start_m, to_m, ticks)):
        known = None if math.isnan(x_m) else np.array([x_m, 0.0, 0.1])
        trace.add(0.02 * tick, RobotState(ROBOT.stance_angles_rad, 0.0, True, base_position_world=known))
    return trace


@pytest.mark.parametrize(
    ("start_m", "to_m", "why"),
    [
        (3.0, 3.4, False),
        (3.0, 3.8, "arena"),
        (3.0, 2.2, "arena"),
        (math.nan, math.nan, "no position"),
    ],
)
def test_a_fence_around_the_start_says_why_a_walk_ends(start_m: float, to_m: float, why: bool | str) -> None:
    assert Geofence(1.0)(walked(start_m, to_m)) == why


@pytest.mark.parametrize(
    ("known", "turns", "missing", "why"),
    [(True, True, 60, False)]
    + [(known, False, *end) for known in (True, False) for end in ((40, False), (60, "no position"))],
)
def test_a_walk_without_a_new_position_for_a_second_ends_and_is_not_complete(
    known: bool, turns: bool, missing: int, why: bool | str
) -> None:
    """A position that repeats itself is as good as none, unless the body turns."""
    trace = walked(0.0, 0.1)
    for tick in range(missing):
        here = np.array([0.1, 0.0, 0.1]) if known else None
        faces = about_z(0.01 * tick * turns)
        state = RobotState(ROBOT.stance_angles_rad, 0.0, True, None if here is None else here, faces)
        trace.add(0.0, state)
    assert Geofence(1.0)(trace) == why
    assert Geofence(1.0).at_end(trace) == (why or None)


def test_a_robot_that_may_have_left_its_fence_since_it_was_seen_is_stopped() -> None:
    trace = walked(0.0, 0.4, ticks=51)
    assert Geofence(1.4)(trace) is False
    for _ in range(45):
        trace.add(0.0, RobotState(ROBOT.stance_angles_rad, 0.0, True))
    assert Geofence(1.4)(trace) == "arena"


def test_a_fence_around_a_place_lets_a_robot_return_to_it() -> None:
    place = Arena(home_m=(0.0, 0.0), radius_m=1.0)
    assert Geofence(place)(walked(3.0, 2.5)) is False
    assert Geofence(place)(walked(3.0, 3.5)) == "arena"
    assert Geofence(place, lambda _: True)(walked(0.1, 0.2)) is True


def test_a_tight_arena_is_spoken_of_and_a_wide_one_is_not() -> None:
    ant = {"ideal_m": 4.455, "least_m": 2.154}
    notes = [check_radius(radius_m, **ant) for radius_m in (1.2, 2.2, 2.23, 4.4)]
    assert len(set(notes)) == 3
    assert notes[2] == notes[3]
    assert None not in notes
    assert check_radius(4.5, **ant) is None
    with pytest.raises(InputError, match="arena"):
        check_radius(1.0, **ant)
