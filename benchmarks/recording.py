"""What recording adds to a simulated trial, in time and on the disk.

The first import of Rerun and the creation of the file, which also writes scene and layout, are excluded: they
happen before the robot moves. Blocks, outcome, flush and close are included.
"""

import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.plans import ant, default_gait
from benchmarks.rows import Bar, Row
from benchmarks.scale import Scale
from benchmarks.timing import alternate, median_ratio, spread
from hexctl.backends.sim.servos import SimServos
from hexctl.control.guard import Guard
from hexctl.control.log import PACED_BLOCK_TICKS, Recorders
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.recording.recording import Recording

MEGABYTE = 1e6


def recording_rows(scale: Scale) -> Iterator[Row]:
    """Wall time of a recorded trial over the same trial not recorded, and the size of the file."""
    with TemporaryDirectory() as folder:
        trials = _Trials(TrialPlan(gait=default_gait(), duration_s=scale.walk_s), Path(folder))
        trials.recorded()
        pairs = alternate(trials.recorded, trials.plain, scale.trial_rounds)
        times = ", ".join(f"{1e3 * median(column):.0f} ms" for column in zip(*pairs, strict=True))
        note = f"walk {scale.walk_s:g} s; recorded and not: {times}; {spread(pairs)}"
        yield Row("recording.time", median_ratio(pairs), "ratio", Bar(high=1.15), note)
        note = "p99.9 of a walk that keeps time, all that a tick does, what is due of its recording included"
        yield Row("recording.longest_tick", trials.longest_tick_ms(), "ms", Bar(high=10), note)
        size = trials.bytes_on_disk / MEGABYTE
        note = f"the file of a trial that walks {scale.walk_s:g} s, settling and stop included"
        yield Row("recording.size", size, "MB", Bar(high=1.5), note)


class _Trials:
    """The same trial, recorded and not."""

    def __init__(self, plan: TrialPlan, folder: Path) -> None:
        self._plan, self._folder = plan, folder
        self._count = 0
        self.bytes_on_disk = 0

    def recorded(self) -> float:
        """Return the wall time in s of a trial that is recorded."""
        self._count += 1
        path = self._folder / f"{self._count}.rrd"
        with (
            SimServos(ant()) as servos,
            Recording(path, ant(), self._plan, title="benchmark") as recording,
        ):
            recorders = Recorders(recording)
            began_s = time.perf_counter()
            result = run_trial(Guard(servos), self._plan, recorders=recorders)
            recording.finish(result, {})
            recording.close()
            wall_s = time.perf_counter() - began_s
        _raise_first(recorders)
        self.bytes_on_disk = path.stat().st_size
        return wall_s

    def longest_tick_ms(self) -> float:
        """Return the 99.9th percentile of the work of a tick, recorded on the wall clock."""
        path = self._folder / "paced.rrd"
        with (
            SimServos(ant(), realtime=True) as servos,
            Recording(path, ant(), self._plan, title="benchmark") as recording,
        ):
            recorders = Recorders(recording, block_ticks=PACED_BLOCK_TICKS)
            run_trial(Guard(servos), self._plan, recorders=recorders)
        _raise_first(recorders)
        return float(np.percentile(recorders.log["work_s"], 99.9) * 1e3)

    def plain(self) -> float:
        """Return the wall time in s of a trial that is not recorded."""
        with SimServos(ant()) as servos:
            began_s = time.perf_counter()
            run_trial(Guard(servos), self._plan)
            return time.perf_counter() - began_s


def _raise_first(recorders: Recorders) -> None:
    """Raise what the first recorder that failed raised."""
    for failure in recorders.failures:
        raise failure.error
