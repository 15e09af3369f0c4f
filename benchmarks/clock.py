"""50 Hz on the wall clock: as many ticks as there should be, no drift, and no later than a bare loop.

All loops run at the same time, each in a process of its own, their grids evenly shifted so that they do not
meet and see the same load of the machine. Even so the p99 of two bare loops over one minute differs by half
on a machine with anything else to do, because a handful of pauses decides it. Therefore several loops of each
kind run, p99 is taken over windows of two seconds, and the ratio is the median over the windows.
"""

import json
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack

import numpy as np

from benchmarks.loops import LoopLog
from benchmarks.rows import Bar, Row
from benchmarks.scale import Scale
from hexctl.backends.clock import PERIOD_S
from hexctl.types import FloatArray

#: Loops of each kind.
PAIRS = 3

WINDOW_S = 2.0

#: Time for the processes to be ready before the first tick.
HEAD_START_S = 3.0

#: What is still no drift: the noise of two medians of lateness, far below one period.
DRIFT_US = 1000.0


def clock_rows(scale: Scale) -> Iterator[Row]:
    """Ticks, drift and lateness of hexctl's loop on the wall clock, and of a bare deadline loop."""
    expected = round(scale.clock_s / PERIOD_S)
    loops = run_together(("hexctl", "bare") * PAIRS, expected)
    ours = loops["hexctl"]
    realtime = all(loop.realtime for of_kind in loops.values() for loop in of_kind)
    priority = "real-time priority" if realtime else "ordinary priority, real-time was not given"
    count = min(len(loop.time_s) for loop in ours)
    note = f"in {scale.clock_s:g} s, the fewest of {PAIRS} loops; {priority}"
    yield Row("clock.ticks", count, "ticks", Bar(expected - 1, expected + 1), note)
    note = "last fifth of the ticks against the first, median lateness on its own clock"
    yield Row("clock.drift", max(abs(_drift_us(loop)) for loop in ours), "us", Bar(high=DRIFT_US), note)
    note = f"p99 over a bare loop at the same time; median over windows of {WINDOW_S:g} s"
    value = lateness_ratio(loops["hexctl"], loops["bare"], scale.clock_s)
    yield Row("clock.lateness_p99", value, "ratio", Bar(high=1.1), note)


def lateness_ratio(ours: list[LoopLog], others: list[LoopLog], duration_s: float) -> float:
    """Return how late loops are over others at the same time, p99, the median over the windows."""
    ratios = _by_window(ours, duration_s) / _by_window(others, duration_s)
    return float(np.median(ratios[np.isfinite(ratios)]))


def run_together(
    kinds: Sequence[str], ticks: int, head_start_s: float = HEAD_START_S
) -> dict[str, list[LoopLog]]:
    """Run loops of some kinds at the same time and return what they did, by kind."""
    start_s = time.monotonic() + head_start_s
    logs: dict[str, list[LoopLog]] = {kind: [] for kind in kinds}
    with ExitStack() as stack:
        processes = []
        for place, kind in enumerate(kinds):
            shifted_s = start_s + place * PERIOD_S / len(kinds)
            command = [sys.executable, "-m", "benchmarks.loops", kind, str(shifted_s), str(ticks)]
            process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
            processes.append((kind, stack.enter_context(process)))
        for kind, process in processes:
            logs[kind].append(LoopLog(**json.loads(process.communicate()[0])))
    return logs


def _drift_us(loop: LoopLog) -> float:
    """Return how much further behind the grid the ticks of the end are than those of the beginning."""
    behind_s = np.subtract(loop.over_s, loop.time_s)
    fifth = max(1, len(behind_s) // 5)
    return float(np.median(behind_s[-fifth:]) - np.median(behind_s[:fifth])) * 1e6


def _by_window(loops: list[LoopLog], duration_s: float) -> FloatArray:
    """Return the 99th percentile of the lateness in each window, the median of the loops; nan after one."""
    edges_s = np.arange(WINDOW_S, duration_s, WINDOW_S)
    each = []
    for loop in loops:
        late_s, time_s = np.array(loop.late_s), np.array(loop.time_s)
        windows = np.split(late_s, np.searchsorted(time_s, edges_s + PERIOD_S / 2))
        each.append([np.percentile(window, 99) if window.size else np.nan for window in windows])
    return np.asarray(np.median(each, axis=0))
