"""Wall clock on simulated time: absolute grid, counted overruns, no drift; real-time priority."""

import os
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.backends.clock import PERIOD_S
from tests.backends.fake_time import FakeTime


def test_time_and_the_grid_start_when_the_clock_is_first_asked() -> None:
    time = FakeTime(500.0)
    clock = time.clock()
    time.work(3.0)  # between making the clock and starting to tick
    assert clock.now_s == 0
    tick = clock.tick()
    assert (tick.index, tick.time_s) == (1, PERIOD_S)
    assert time.now_s == pytest.approx(503.0 + PERIOD_S)
    assert clock.overruns == 0
    time.work(0.005)
    assert clock.now_s == pytest.approx(PERIOD_S + 0.005)


def test_a_program_that_is_stopped_while_it_waits_knows_so_before_anything_pauses_its_clock() -> None:
    time = FakeTime()
    clock = time.clock()
    clock.tick()
    assert clock.standstill is None
    time.stopped_s = 1.0
    clock.tick()
    said = clock.standstill
    assert said is not None
    assert said.duration_s == pytest.approx(1.0, abs=1e-3)
    clock.pause()
    clock.tick()
    assert clock.standstill is said, "once is enough"


@given(
    works=st.lists(st.floats(0, 0.2), min_size=1, max_size=60),
    early_share=st.floats(0.3, 1),
    start_s=st.floats(0, 1e6),
)
def test_whatever_the_work_every_point_is_run_once_or_counted_as_missed(
    works: list[float], early_share: float, start_s: float
) -> None:
    time = FakeTime(start_s, early_share)
    clock = time.clock()
    indices = [clock.tick().index]
    for work in works:
        time.work(work)
        tick = clock.tick()
        assert tick.index > indices[-1]
        assert tick.late_s >= 0
        assert clock.now_s >= tick.time_s
        assert tick.late_s < PERIOD_S + 1e-6
        indices.append(tick.index)
    assert indices[-1] == len(indices) + clock.overruns


#: What has the priority: a walk and one within it, and neither its end, nor a child, nor a forked one.
PRIORITY = """
import os, subprocess, sys
from hexctl.backends.clock import realtime_priority, request_realtime_priority

def mine():
    print(os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO, flush=True)

for _ in range(2):
    with realtime_priority() as granted:
        if not granted:
            sys.exit("not permitted")
        mine()
        with realtime_priority():
            mine()
        mine()
    mine()
request_realtime_priority()
mine()
ask = "import os; print(os.sched_getscheduler(0) == os.SCHED_FIFO)"
subprocess.run([sys.executable, "-c", ask], check=True)
child = os.fork()
if not child:
    mine()
    os._exit(0)
os.waitpid(child, 0)
"""


@pytest.mark.skipif(not hasattr(os, "SCHED_RESET_ON_FORK"), reason="Linux only")
def test_the_priority_is_for_the_walk_and_neither_after_it_nor_for_its_children() -> None:
    done = subprocess.run(
        [sys.executable, "-c", PRIORITY], capture_output=True, text=True, timeout=120, check=False
    )
    if "not permitted" in done.stderr:
        pytest.skip("realtime priority is not permitted here")
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["True", "True", "True", "False"] * 2 + ["True", "False", "False"]
