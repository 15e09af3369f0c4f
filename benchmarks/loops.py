"""The loops of the clock benchmark, each a process: hexctl's own, seen or not, and one that only sleeps.

`python -m benchmarks.loops hexctl|viewed|bare START_S TICKS` waits for a time on the monotonic clock,
runs, and prints a `LoopLog` as JSON. All ask for real-time priority, as `hexctl run` does on a real robot.
"""

import json
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.plans import ant, default_gait
from hexctl.backends.clock import PERIOD_S, WallClock, request_realtime_priority
from hexctl.backends.mock import MockServos
from hexctl.control.controllers import Walk
from hexctl.control.guard import Guard
from hexctl.control.log import Recorders, TickLog
from hexctl.control.loop import run_controller
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import EStopError
from hexctl.gait.gait import Motion
from hexctl.recording.live import LiveView
from hexctl.types import RobotState


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopLog:
    """What a loop did.

    Attributes:
        realtime: whether the kernel gave it real-time priority.
        overruns: grid points that it skipped.
        time_s: which point of the grid each tick was, since the start.
        late_s: how long after that point it began.
        over_s: when it was over, since the start, read from the clock apart from the loop.
    """

    realtime: bool
    overruns: int
    time_s: list[float]
    late_s: list[float]
    over_s: list[float]


def hexctl_loop(start_s: float, ticks: int, realtime: bool) -> LoopLog:
    """Walk on a mock robot with a wall clock: gait, guard and log, everything but a robot."""
    return _walk(Recorders(TickLog()), start_s, ticks, realtime)


def viewed_loop(start_s: float, ticks: int, realtime: bool) -> LoopLog:
    """Do the same, shown live to a viewer that saves what it is sent, for want of a screen."""
    with TemporaryDirectory() as folder, LiveView(options=("--save", str(Path(folder, "seen.rrd")))) as live:
        live.begin(ant(), TrialPlan(gait=default_gait()), title="benchmark")
        log = _walk(Recorders(live), start_s, ticks, realtime)
        live.close(leave_viewer=False)
    return log


def _walk(recorders: Recorders, start_s: float, ticks: int, realtime: bool) -> LoopLog:
    """Walk and log until so many ticks are over."""
    over_s: list[float] = []
    with MockServos(ant(), clock=WallClock()) as servos:
        clock, guard = servos.clock, Guard(servos)
        walk = Walk(ant(), default_gait(), Motion(), period_s=clock.period_s)
        end_s = (ticks - 0.5) * clock.period_s

        def until(_: int, __: RobotState) -> bool:
            over_s.append(time.monotonic() - start_s)
            return clock.now_s > end_s

        _wait_until(start_s)
        # A pause of the machine beyond the command expiry stops the robot, and the missing ticks tell.
        with suppress(EStopError):
            run_controller(guard, walk, (recorders,), until=until)
    return LoopLog(
        realtime=realtime,
        overruns=clock.overruns,
        time_s=recorders.log["time_s"].tolist(),
        late_s=recorders.log["late_s"].tolist(),
        over_s=over_s,
    )


def bare_loop(start_s: float, ticks: int, realtime: bool) -> LoopLog:
    """Sleep to the points of an absolute grid and do nothing else."""
    time_s, late_s, over_s = [], [], []
    _wait_until(start_s)
    origin_s = time.monotonic()
    for index in range(1, ticks + 1):
        deadline_s = origin_s + index * PERIOD_S
        while (wait_s := deadline_s - time.monotonic()) > 0:
            time.sleep(wait_s)
        late_s.append(-wait_s)
        time_s.append(index * PERIOD_S)
        over_s.append(deadline_s - wait_s - start_s)
    return LoopLog(realtime=realtime, overruns=0, time_s=time_s, late_s=late_s, over_s=over_s)


LOOPS: dict[str, Callable[[float, int, bool], LoopLog]] = {
    "hexctl": hexctl_loop,
    "viewed": viewed_loop,
    "bare": bare_loop,
}


def _wait_until(start_s: float) -> None:
    while (wait_s := start_s - time.monotonic()) > 0:
        time.sleep(wait_s)


def main(arguments: list[str]) -> None:
    """Run one loop and print its log."""
    kind, start_s, ticks = arguments
    realtime = request_realtime_priority()
    print(json.dumps(asdict(LOOPS[kind](float(start_s), int(ticks), realtime))))


if __name__ == "__main__":
    main(sys.argv[1:])
