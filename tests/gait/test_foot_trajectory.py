"""The foot trajectory against the paper's Eq. 1 to 5, one leg and one moment at a time."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.gait.encoding import Slots
from hexctl.gait.foot_trajectory import (
    RAMP_DURATION_S,
    StepPattern,
    feet_of_walks,
    gait_feet_body,
    in_stance,
    lift_offset,
    part_of_cycle,
    stroke_offset,
    stroke_vectors_m,
)
from hexctl.gait.gait import NAMED_SLOTS, Gait, Motion, ideal_speed_m_s
from tests.robots import ROBOT_NAMES, shipped

Vector = tuple[float, float, float]


def stroke(u: float, amplitude: float) -> float:
    """Offset m(u) in the plane, Eq. 3."""
    if u < 1 / 3:
        return 3 * u * amplitude / 2
    if u < 1 / 2:
        return amplitude / 2 - 3 * amplitude * (u - 1 / 3)
    if u < 2 / 3:
        return -3 * amplitude * (u - 1 / 2)
    return -amplitude / 2 * (1 - 3 * (u - 2 / 3))


def lift(u: float, height: float) -> float:
    """Height h(u), Eq. 4."""
    if u < 1 / 3:
        return 0.0
    if u < 1 / 2:
        return 6 * height * (u - 1 / 3)
    if u < 2 / 3:
        return height * (1 - 6 * (u - 1 / 2))
    return 0.0


def normalised_time(t: float, slot: int) -> float:
    """Normalised time u, Eq. 5."""
    return math.fmod(t + (slot - 1) / 6, 1.0)


def walking_feet(
    rest: list[Vector], slots: Slots, t: float, *, amplitude: float, height: float, theta: float
) -> list[Vector]:
    """Feet, Eq. 1 and 2; as printed, the stance feet move toward theta."""
    feet = []
    for (x, y, z), slot in zip(rest, slots, strict=True):
        u = normalised_time(t, slot)
        m = stroke(u, amplitude)
        feet.append((x + m * math.cos(theta), y + m * math.sin(theta), z + lift(u, height)))
    return feet


phases = st.floats(0, 1, exclude_max=True)


@given(u=phases)
def test_stroke_and_lift_are_equations_3_and_4(u: float) -> None:
    assert float(stroke_offset(np.array(u))) == pytest.approx(stroke(u, amplitude=1.0), abs=1e-12)
    assert float(lift_offset(np.array(u))) == pytest.approx(lift(u, height=1.0), abs=1e-12)


@given(t=st.floats(-1e-300, 1e5), slot=st.integers(1, 6))
def test_phase_is_equation_5(t: float, slot: int) -> None:
    u = float(part_of_cycle(np.array(t + (slot - 1) / 6)))
    assert 0 <= u < 1
    # On a circle: just below 1 and 0 are neighbours.
    assert math.remainder(u - normalised_time(t, slot), 1.0) == pytest.approx(0, abs=1e-9)


def test_the_foot_is_on_the_floor_exactly_in_stance() -> None:
    u = np.arange(6000) / 6000
    lifted = lift_offset(u)
    np.testing.assert_allclose(lifted[in_stance(u)], 0, atol=1e-12)
    swinging = ~in_stance(u) & (np.abs(u - 1 / 3) > 1e-9)
    assert (lifted[swinging] > 0).all()
    assert in_stance(u).mean() == pytest.approx(2 / 3, abs=1e-3)


TRIPOD = Gait(slots=NAMED_SLOTS["tripod"], pace_hz=0.9, amplitude=0.11, height=0.02)

#: Later by this, the phases are the same and the amplitude is full.
TEN_CYCLES_S = 10 / 0.9

headings = st.floats(-math.pi, math.pi)
slots_of_legs = st.tuples(*[st.integers(1, 6)] * 6)


@given(slots=slots_of_legs, heading=headings, time_s=st.floats(RAMP_DURATION_S, 60))
def test_the_walk_is_the_papers_with_the_body_going_along_the_heading(
    slots: tuple[int, ...], heading: float, time_s: float
) -> None:
    ant = shipped()
    gait = Gait(slots=slots, pace_hz=0.9, amplitude=0.11, height=0.02)
    feet = gait_feet_body(ant, gait, Motion(heading_rad=heading), time_s)
    expected = walking_feet(
        [(x, y, z) for x, y, z in ant.stance_feet_body.tolist()],
        slots,
        0.9 * time_s,
        amplitude=0.11,
        height=0.02,
        theta=heading + math.pi,  # the sign trap: the body goes where the stance feet do not
    )
    np.testing.assert_allclose(feet, expected, atol=1e-9)


@given(heading=headings, turn=st.floats(-0.3, 0.3), travel=st.floats(0, 1), name=st.sampled_from(ROBOT_NAMES))
def test_a_stance_foot_moves_as_the_floor_does_under_a_moving_body(
    heading: float, turn: float, travel: float, name: str
) -> None:
    """A body that travels at v and turns at w sees the floor at r move with -v - w x r."""
    robot = shipped(name)
    gait = Gait(slots=NAMED_SLOTS["demo"], pace_hz=0.5, amplitude=0.08, height=0.02)
    motion = Motion(heading_rad=heading, travel=travel, turn_rate_rad_s=turn)
    step_s, start_s = 1e-4, RAMP_DURATION_S
    times = start_s + np.arange(0, 2000, 10) * 1e-3
    before = gait_feet_body(robot, gait, motion, times)
    after = gait_feet_body(robot, gait, motion, times + step_s)
    u, later = (
        part_of_cycle(gait.pace_hz * at_s[:, np.newaxis] + np.array(gait.leg_phases))
        for at_s in (times, times + step_s)
    )
    both = in_stance(u) & in_stance(later)
    speed = 1.5 * 0.5 * 0.08 * robot.size_m * travel
    rest = robot.stance_feet_body
    floor = np.stack(
        [-speed * math.cos(heading) + turn * rest[:, 1], -speed * math.sin(heading) - turn * rest[:, 0]],
        axis=-1,
    )
    velocity = (after - before)[..., :2] / step_s
    np.testing.assert_allclose(velocity[both], np.broadcast_to(floor, velocity.shape)[both], atol=1e-9)
    down, height = in_stance(u), np.broadcast_to(rest[:, 2], u.shape)
    np.testing.assert_allclose(before[..., 2][down], height[down], atol=1e-12)


def test_the_ideal_speed_is_the_papers() -> None:
    assert ideal_speed_m_s(shipped(), TRIPOD, Motion()) == pytest.approx(0.1485)
    assert ideal_speed_m_s(shipped(), TRIPOD, Motion(travel=0.0)) == 0


def _offsets(time_s: Any, stop_s: float | None = None) -> Any:
    ant = shipped()
    return gait_feet_body(ant, TRIPOD, Motion(), time_s, stop_s) - ant.stance_feet_body


def test_a_walk_starts_in_the_stance_and_grows_to_the_full_stride_in_two_seconds() -> None:
    np.testing.assert_array_equal(_offsets(0.0), np.zeros((6, 3)))
    times = np.arange(0, 2000) * 1e-3
    full = _offsets(times + TEN_CYCLES_S)
    np.testing.assert_allclose(_offsets(times), 0.5 * times[:, np.newaxis, np.newaxis] * full, atol=1e-9)


@given(stop_s=st.floats(0, 20))
def test_a_soft_stop_shrinks_evenly_to_the_stance(stop_s: float) -> None:
    since = np.linspace(0, RAMP_DURATION_S, 201)
    share = np.maximum(min(stop_s, 2.0) / 2 - since / 2, 0)[:, np.newaxis, np.newaxis]
    full = _offsets(stop_s + since + TEN_CYCLES_S)
    np.testing.assert_allclose(_offsets(stop_s + since, stop_s), share * full, atol=1e-9)
    np.testing.assert_allclose(_offsets(stop_s + RAMP_DURATION_S + 1e-9, stop_s), 0, atol=1e-12)


walks_of_all_kinds = st.tuples(
    slots_of_legs,
    st.floats(0.1, 2),
    st.floats(0.01, 0.2),
    st.floats(0.01, 0.1),
    headings,
    st.floats(-0.5, 0.5),
)


@given(
    walks=st.lists(walks_of_all_kinds, min_size=1, max_size=5),
    stop_s=st.none() | st.floats(0, 5),
    name=st.sampled_from(ROBOT_NAMES),
)
def test_many_walks_at_once_equal_each_alone_to_the_last_bit(
    walks: list[tuple[tuple[int, ...], float, float, float, float, float]], stop_s: float | None, name: str
) -> None:
    robot, times = shipped(name), 0.02 * np.arange(300.0)
    gaits = [
        Gait(slots=slots, pace_hz=pace, amplitude=amplitude, height=height)
        for slots, pace, amplitude, height, _, _ in walks
    ]
    motions = [Motion(heading_rad=walk[4], turn_rate_rad_s=walk[5]) for walk in walks]
    pairs = list(zip(gaits, motions, strict=True))
    together = feet_of_walks(
        robot,
        StepPattern.of(robot, gaits),
        stroke_vectors=np.array([stroke_vectors_m(robot, gait, motion) for gait, motion in pairs]),
        time_s=times,
        stop_s=stop_s,
    )
    for row, (gait, motion) in zip(together, pairs, strict=True):
        assert np.array_equal(row, gait_feet_body(robot, gait, motion, times, stop_s))
