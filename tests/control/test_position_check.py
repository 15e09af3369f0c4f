"""Positions that a robot cannot have reached are not believed, and are counted."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.control.position_check import MOST_CORRECTION_M, MOST_M, MOST_SPEED_M_S, TOLD_S, PositionCheck
from hexctl.types import FloatArray
from tests.control.posed import connected, read_for

TICK_S = 0.02


def at(x_m: float) -> FloatArray:
    return np.array([x_m, 0.0, 0.1])


@pytest.mark.parametrize("x_m", [3e38, -3e38, 1e300, math.inf, math.nan, MOST_CORRECTION_M + 0.2, -3.0])
def test_a_jump_is_not_believed(x_m: float) -> None:
    check = PositionCheck()
    assert check.believes(at(0.0), 0.0)
    assert not check.believes(at(x_m), TICK_S)
    assert check.believes(at(0.001), 2 * TICK_S)
    assert check.doubted == 1
    check.forget()  # the next is taken as it is, but no robot is beyond the earth
    assert check.believes(at(100.0), TICK_S)
    for nowhere_m in (3e38, math.inf, math.nan, 2.1 * MOST_M):
        assert not PositionCheck().believes(at(nowhere_m), 0.0)
    assert PositionCheck().believes(at(0.5 * MOST_M), 0.0)


@given(st.lists(st.floats(-1, 1), min_size=1, max_size=50))
def test_a_robot_that_moves_as_it_can_is_believed(speeds: list[float]) -> None:
    check, x_m = PositionCheck(), 0.0
    for tick, speed in enumerate(speeds):
        x_m += speed * MOST_SPEED_M_S * TICK_S
        assert check.believes(at(x_m), tick * TICK_S)
    assert check.doubted == 0


def test_a_place_that_stays_is_believed_once_it_can_be_reached() -> None:
    check = PositionCheck()
    check.believes(at(0.0), 0.0)
    believed = [check.believes(at(3.0), tick * TICK_S) for tick in range(1, 51)]
    first_s = (believed.index(True) + 1) * TICK_S
    assert first_s == pytest.approx((3.0 - MOST_CORRECTION_M) / MOST_SPEED_M_S, abs=TICK_S)
    assert all(believed[believed.index(True) :])
    assert check.doubted == 1  # the same position, again and again


def test_it_tells_of_the_first_jump_of_several_and_for_a_while() -> None:
    check = PositionCheck()
    check.believes(at(0.0), 0.0)
    assert check.doubt(0.0) is None
    for tick in range(3):
        check.believes(at(3e38 / (tick + 1)), tick * TICK_S)
    assert "3e+38 m" in (check.doubt(3 * TICK_S) or "")
    assert check.doubt(3 * TICK_S + TOLD_S) is None
    assert check.doubted == 3


def test_behind_the_guard_a_jump_is_no_position_and_does_not_stop() -> None:
    guard, servos = connected()
    read_for(guard, 0.1)
    servos.position_world = at(3e38)
    read_for(guard, 0.1)
    state = guard.read()
    assert state.base_position_world is None
    assert state.base_quaternion_world is not None
    assert guard.peek().base_position_world is None
    servos.position_world = at(0.01)
    read_for(guard, 0.1)
    assert guard.read().base_position_world is not None
    assert guard.stopped is None
    assert guard.positions.doubted == 1
    servos.position_world = at(3e38)
    read_for(guard, 6.0)
    assert guard.stopped == "pose lost"
