"""The arena as geometry: a walk that is aimed fits where it can, wherever home is."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from hexctl.adapt.arena import Arena, check_radius
from hexctl.errors import InputError
from hexctl.types import FloatArray

RADII = st.floats(0.5, 20)
PLACES = st.floats(-50, 50)
ANGLES = st.floats(-math.pi, math.pi)
SHARES = st.floats(0, 1)

#: An ideal walk of `ant`, and the least valid one.
IDEAL_M, LEAST_M = 4.455, 2.154


def at(arena: Arena, distance_m: float, angle_rad: float) -> FloatArray:
    """Return the position so far from home in a direction."""
    x, y = arena.home_m
    return np.array([x + distance_m * math.cos(angle_rad), y + distance_m * math.sin(angle_rad), 0.1])


def ahead(position: FloatArray, heading_rad: float, distance_m: float) -> FloatArray:
    return position + distance_m * np.array([math.cos(heading_rad), math.sin(heading_rad), 0.0])


@given(RADII, PLACES, PLACES, SHARES, ANGLES, ANGLES)
def test_no_heading_has_more_room_than_the_one_it_aims(
    radius_m: float, x: float, y: float, share: float, angle_rad: float, other_rad: float
) -> None:
    arena = Arena(home_m=(x, y), radius_m=radius_m)
    position = at(arena, share * radius_m, angle_rad)
    room_m = arena.room_m(position, arena.aim_rad(position, 0.0))
    assert room_m >= arena.room_m(position, other_rad) - 0.11  # at home, anywhere will do
    assert room_m == pytest.approx(radius_m + share * radius_m, abs=0.11)


@given(RADII, PLACES, PLACES, SHARES, ANGLES, ANGLES)
def test_room_ends_on_the_edge(
    radius_m: float, x: float, y: float, share: float, angle_rad: float, heading_rad: float
) -> None:
    arena = Arena(home_m=(x, y), radius_m=radius_m)
    position = at(arena, 0.999 * share * radius_m, angle_rad)
    room_m = arena.room_m(position, heading_rad)
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
    assert arena.room_m(position, aim_rad) == pytest.approx(2.0 * away + 2.0)
    assert arena.room_m(position, aim_rad + math.pi) == 0


@given(RADII, st.floats(0.5, 40), SHARES, ANGLES)
def test_a_start_has_room_for_the_walk_wherever_there_is_any(
    radius_m: float, reach_m: float, share: float, angle_rad: float
) -> None:
    arena = Arena(home_m=(1.0, -2.0), radius_m=radius_m)
    position = at(arena, share * radius_m, angle_rad)
    room_m = arena.room_m(position, arena.aim_rad(position, 0.0))
    if not arena.too_near(position, reach_m):
        assert room_m >= min(reach_m, 2 * radius_m) - 0.1 - 1e-9
    else:
        assert room_m < reach_m
        assume(2 * radius_m >= reach_m)
        started = at(arena, arena.start(reach_m).radius_m, angle_rad)
        assert arena.room_m(started, arena.aim_rad(started, 0.0)) >= reach_m - 1e-9


@given(ANGLES)
def test_at_home_it_goes_where_it_is_told(heading_rad: float) -> None:
    arena = Arena(home_m=(3.0, 4.0), radius_m=5.0)
    assert arena.aim_rad(np.array([3.01, 4.0, 0.1]), heading_rad) == heading_rad


@pytest.mark.parametrize("radius_m", [0.0, -1.0, math.nan, math.inf])
def test_a_radius_that_is_none_is_refused(radius_m: float) -> None:
    with pytest.raises(InputError, match="--arena"):
        check_radius(radius_m, ideal_m=IDEAL_M, least_m=LEAST_M)


def test_an_arena_without_any_valid_straight_walk_is_refused() -> None:
    with pytest.raises(InputError, match=r"2\.23 m or more"):
        check_radius(1.0, ideal_m=IDEAL_M, least_m=LEAST_M)


@pytest.mark.parametrize(
    ("radius_m", "words"),
    [(1.2, "2.4 m across"), (2.2, "cut short"), (2.23, "walks there first"), (4.4, "2.23 m from the middle")],
)
def test_a_tight_arena_is_spoken_of(radius_m: float, words: str) -> None:
    assert words in str(check_radius(radius_m, ideal_m=IDEAL_M, least_m=LEAST_M))


def test_a_wide_arena_needs_no_words() -> None:
    assert check_radius(4.5, ideal_m=IDEAL_M, least_m=LEAST_M) is None
