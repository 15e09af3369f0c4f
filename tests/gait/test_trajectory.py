"""The foot trajectory against the paper's Eq. 3 to 5, written out case by case."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.gait.trajectory import in_stance, lift_offset, phase_in_cycle, stroke_offset
from tests.gait.paper import lift, normalised_time, stroke

phases = st.floats(0, 1, exclude_max=True)


@given(u=phases)
def test_stroke_is_equation_3(u: float) -> None:
    assert float(stroke_offset(np.array(u))) == pytest.approx(stroke(u, amplitude=1.0), abs=1e-12)


@given(u=phases)
def test_lift_is_equation_4(u: float) -> None:
    assert float(lift_offset(np.array(u))) == pytest.approx(lift(u, height=1.0), abs=1e-12)


@given(t=st.floats(0, 1e5), slot=st.integers(1, 6))
def test_phase_is_equation_5(t: float, slot: int) -> None:
    u = float(phase_in_cycle(t, slot))
    assert 0 <= u < 1
    # On a circle: just below 1 and 0 are neighbours.
    assert math.remainder(u - normalised_time(t, slot), 1.0) == pytest.approx(0, abs=1e-9)


@given(t=st.floats(-1e-300, 1e6), slot=st.integers(1, 6))
def test_phase_never_reaches_one(t: float, slot: int) -> None:
    assert 0 <= float(phase_in_cycle(t, slot)) < 1


@given(u=phases, step=st.floats(0, 1e-6))
def test_the_foot_never_jumps_not_even_from_one_cycle_to_the_next(u: float, step: float) -> None:
    before, after = np.array(u), phase_in_cycle(u + step, 1)
    assert abs(float(stroke_offset(after) - stroke_offset(before))) <= 3 * step + 1e-12
    assert abs(float(lift_offset(after) - lift_offset(before))) <= 6 * step + 1e-12


def test_the_foot_is_on_the_floor_exactly_in_stance() -> None:
    u = np.arange(6000) / 6000
    lifted = lift_offset(u)
    np.testing.assert_allclose(lifted[in_stance(u)], 0, atol=1e-12)
    swinging = ~in_stance(u) & (np.abs(u - 1 / 3) > 1e-9)
    assert (lifted[swinging] > 0).all()
    assert in_stance(u).mean() == pytest.approx(2 / 3, abs=1e-3)


def test_a_stroke_spans_the_amplitude_and_a_lift_the_height() -> None:
    u = np.arange(6000) / 6000
    assert (stroke_offset(u).min(), stroke_offset(u).max()) == pytest.approx((-0.5, 0.5), abs=1e-9)
    assert lift_offset(u).max() == pytest.approx(1.0)
    assert u[lift_offset(u).argmax()] == 0.5


def test_many_legs_and_times_at_once_equal_each_alone() -> None:
    cycles, slots = np.linspace(0, 3, 40)[:, np.newaxis], np.array([1, 4, 2, 6, 3, 5])
    together = phase_in_cycle(cycles, slots)
    alone = [[float(phase_in_cycle(float(t), int(g))) for g in slots] for t in cycles[:, 0]]
    np.testing.assert_array_equal(together, alone)
