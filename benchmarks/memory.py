"""How memory grows while a robot walks: of the process that walks it, and of one that serves a simulation.

Each walk has a process of its own, so that nothing that ran before counts.
"""

import ctypes
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.link import free_port, served
from benchmarks.plans import ant, default_gait
from benchmarks.rows import Bar, Row
from benchmarks.scale import Scale
from hexctl.backends.clock import PERIOD_S
from hexctl.backends.sim.servos import SimServos
from hexctl.control.guard import Guard
from hexctl.control.log import BLOCK_TICKS, PACED_BLOCK_TICKS, Recorders, TickLog
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.recording import recording
from hexctl.runs.run import run

MEGABYTE = 1e6
HOUR_S = 3600.0

#: What is kept however long a walk is, such as the rows of the last minutes, fills up in this part of it.
FILLING = 0.25

#: Growth of an hour that a robot's own computer does not notice.
BAR = Bar(high=1.0)


def memory_rows(scale: Scale) -> Iterator[Row]:
    """Growth of an hour of walking: simulated, not recorded and recorded, and recorded over the link."""
    with TemporaryDirectory() as folder:
        plain = _in_child(_simulated, scale.memory_s, None)
        yield plain.row("memory.plain", f"{scale.memory_s:g} s of simulated walk, not recorded")
        recorded = _in_child(_simulated, scale.memory_s, Path(folder) / "simulated.rrd")
        note = f"the same recorded, a piece of each track a second; file of {recorded.file_mb:.0f} MB"
        yield recorded.row("memory.recorded", note)
        port = free_port()
        with served(port, "sim") as server:
            path = Path(folder) / "linked.rrd"
            walk = _in_child(_over_the_link, port, server.pid, scale.memory_link_s, path)
    note = f"{walk.ended} after {scale.memory_link_s:g} s over the link, recorded, {walk.overruns} skipped"
    yield walk.row("memory.client", note)
    yield walk.row("memory.serve", "the served simulation that was walked", process=1)


@dataclass(frozen=True, slots=True)
class Growth:
    """Memory of processes in the course of a walk.

    Attributes:
        samples: time in s, and resident memory of each process in MB.
        file_mb: size of the recording.
        ended: status of the walk.
        overruns: points of the 50 Hz grid that were skipped.
    """

    samples: Sequence[tuple[float, ...]]
    file_mb: float = 0.0
    ended: str = "ok"
    overruns: int = 0

    def row(self, name: str, note: str, process: int = 0) -> Row:
        """The growth of one process in an hour, by a line through all but the beginning."""
        times_s, *memories_mb = np.array(self.samples).T
        late = times_s >= FILLING * times_s[-1]
        if np.count_nonzero(late) < 2:
            return Row(name, None, "MB/h", BAR, note)
        slope = np.polyfit(times_s[late], memories_mb[process][late], 1)[0]
        return Row(name, float(slope) * HOUR_S, "MB/h", BAR, note)


@dataclass
class Watch:
    """A recorder that notes the memory of processes once a second.

    A simulation runs ahead of the threads that write, by more at some times than at others: with `trimmed`
    what this process has free is given back before, so that it counts for nothing.
    """

    pids: tuple[int, ...]
    trimmed: bool = False
    samples: list[tuple[float, ...]] = field(default_factory=list)
    block_ticks: int | None = BLOCK_TICKS

    def write_block(self, _log: TickLog, _start: int, stop: int) -> None:
        """Note it at the end of rows of a log."""
        if self.trimmed:
            with suppress(OSError, AttributeError):  # another C library
                ctypes.CDLL("libc.so.6").malloc_trim(0)
        self.samples.append((stop * PERIOD_S, *map(resident_mb, self.pids)))


def resident_mb(pid: int) -> float:
    """Resident memory of a process in MB."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / MEGABYTE


def _in_child(walk: Callable[..., Growth], *arguments: Any) -> Growth:
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(walk, *arguments).result()


def _simulated(duration_s: float, path: Path | None) -> Growth:
    """Walk as fast as possible; recorded in the pieces in which a walk in real time is."""
    recording.BLOCK_TICKS = BLOCK_TICKS
    plan = TrialPlan(gait=default_gait(), duration_s=duration_s)
    watch = Watch((os.getpid(),), trimmed=True)
    with SimServos(ant()) as servos:
        if path is None:
            run_trial(Guard(servos), plan, recorders=(watch,))
            return Growth(watch.samples)
        with recording.Recording(path, ant(), plan, title="benchmark") as recorded:
            recorders = Recorders(recorded, watch, block_ticks=PACED_BLOCK_TICKS)
            result = run_trial(Guard(servos), plan, recorders=recorders)
            for failure in recorders.failures:
                raise failure.error
            recorded.finish(result, {})
    return Growth(watch.samples, path.stat().st_size / MEGABYTE)


def _over_the_link(port: int, server: int, duration_s: float, path: Path) -> Growth:
    watch = Watch((os.getpid(), server))
    done = run(
        backend="zenoh",
        connect=f"tcp/127.0.0.1:{port}",
        robot="ant",
        duration_s=duration_s,
        record=path,
        recorders=(watch,),
    )
    ended = done.trial.status if done.trial.stopped is None else f"{done.trial.status} ({done.trial.stopped})"
    return Growth(watch.samples, path.stat().st_size / MEGABYTE, ended, done.outcome["overruns"])
