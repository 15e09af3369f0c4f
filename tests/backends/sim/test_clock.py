"""The simulation's clock, free and paced, on a time of the test's own."""

import pytest

from hexctl.backends.clock import PERIOD_S
from hexctl.backends.sim.clock import SimClock
from tests.backends.fake_time import FakeTime


def test_each_tick_steps_once_and_no_time_but_its_own_passes() -> None:
    steps: list[float] = []
    clock = SimClock(lambda: steps.append(clock.now_s))
    for index in range(1, 4):
        tick = clock.tick()
        assert (tick.index, tick.late_s) == (index, 0.0)
        assert clock.now_s == tick.time_s == index * PERIOD_S
    assert len(steps) == 3


def test_a_paced_clock_waits_for_the_wall() -> None:
    time = FakeTime(50.0)
    clock = SimClock(lambda: time.work(0.004), time.clock())
    for index in range(1, 101):
        clock.tick()
        assert time.now_s == pytest.approx(50.0 + index * PERIOD_S + 0.004, abs=1e-6)
    assert clock.overruns == 0


def test_a_paced_clock_that_is_late_counts_but_never_skips() -> None:
    time = FakeTime()
    steps: list[int] = []
    clock = SimClock(lambda: steps.append(1), time.clock())
    clock.tick()
    time.work(5.5 * PERIOD_S)
    tick = clock.tick()
    assert (tick.index, len(steps)) == (2, 2)
    assert tick.time_s == pytest.approx(2 * PERIOD_S)
    assert clock.overruns == 4


def test_a_step_that_fails_does_not_count() -> None:
    def fail() -> None:
        raise ZeroDivisionError

    clock = SimClock(fail)
    with pytest.raises(ZeroDivisionError):
        clock.tick()
    assert clock.now_s == 0
