"""Clocks: when the next control tick is due. The clock belongs to the servos."""

import math
import os
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

from hexctl.time_source import WALL_TIME, TimeSource

#: The control period of hexctl, 50 Hz.
PERIOD_S = 0.02

#: After a long sleep the processor wakes up slowly; a second one as short as this ends on time.
NAP_S = 0.0003

#: Nothing is taken up in this time before a tick is due, so that the tick is not late.
SPARE_S = 0.0003

#: Between two ticks: a robot at the other end takes it for silence.
STANDSTILL_S = 0.2


@dataclass(frozen=True, slots=True)
class Standstill:
    """A time in which this program missed its ticks; `ended_s` is by the clock's time source."""

    duration_s: float
    ended_s: float = -math.inf

    def __str__(self) -> str:
        return (
            f"this program stood still for {self.duration_s:.1f} s: it was stopped, or this computer kept it "
            "waiting"
        )


@dataclass(frozen=True, slots=True)
class Tick:
    """One point of a clock's grid; `time_s` is index * period since the clock began.

    `index` skips missed points; `late_s` is the delay of the tick after the grid point.
    """

    index: int
    time_s: float
    late_s: float = 0.0


class Clock(ABC):
    """One tick per control period.

    Attributes:
        index: number of the newest tick's grid point, 0 before the first.
        overruns: grid points missed so far because a tick took too long.
        standstill: the last one, or None.
        waits: whether its ticks wait for the time.
    """

    standstill: Standstill | None = None
    waits = False

    def __init__(self, period_s: float = PERIOD_S, *, time: TimeSource = WALL_TIME) -> None:
        self.period_s, self.time = period_s, time
        self.index = self.overruns = 0

    @abstractmethod
    def tick(self) -> Tick:
        """The next grid point, after waiting for it or making it come."""

    @property
    @abstractmethod
    def now_s(self) -> float:
        """Time since the clock began, on the axis of `Tick.time_s`."""

    @property
    def due_in_s(self) -> float:
        """How long the next `tick` would wait; 0 without a wait or if unknown."""
        return 0.0

    def standing_still(self) -> Standstill | None:
        """Standstill that delayed this tick, or the last one if it has just ended; else None."""
        last = self.standstill
        return last if last is not None and self.time.now() - last.ended_s < STANDSTILL_S else None

    @abstractmethod
    def pause(self) -> None:
        """Expect no tick for a while: grid points missed before the next one are no overruns."""


class WallClock(Clock):
    """Waits for the next point of an absolute grid of wall time.

    A tick late by less than a period runs immediately, without drift. Missed grid points are skipped and
    counted as overruns: a robot must not be sent a burst of old targets.
    """

    waits = True

    def __init__(self, period_s: float = PERIOD_S, *, time: TimeSource = WALL_TIME) -> None:
        super().__init__(period_s, time=time)
        self._origin_s: float | None = None
        self._paused = False

    @property
    def now_s(self) -> float:
        """Time since the first call of `tick`."""
        return 0.0 if self._origin_s is None else self.time.now() - self._origin_s

    def begin(self, at_s: float) -> None:
        """Begin the grid at a time of the time source, unless it has begun."""
        if self._origin_s is None:
            self._origin_s = at_s

    @property
    def due_in_s(self) -> float:
        """Time until the next grid point."""
        return 0.0 if self._origin_s is None else max(0.0, (self.index + 1) * self.period_s - self.now_s)

    def pause(self) -> None:
        """Count no overruns until the next tick."""
        self._paused = True

    def standing_still(self) -> Standstill | None:
        """Standstill that delayed this tick, or the last one if it has just ended; else None."""
        passed_s = self.now_s - self.index * self.period_s
        if self.index and not self._paused and passed_s > STANDSTILL_S:
            return Standstill(passed_s, self.time.now())
        return super().standing_still()

    def tick(self) -> Tick:
        """The next grid point, after sleeping until it; missed points are skipped."""
        if self._origin_s is None:
            self._origin_s = self.time.now()
        due = self.index + 1
        newest = math.floor(self.now_s / self.period_s)
        if newest > due:
            if super().standing_still() is None:  # not yet reported by the late tick
                self.standstill = self.standing_still() or self.standstill
            self.overruns += 0 if self._paused else newest - due
            due = newest
        self._paused = False
        self.index = due
        origin_s, time_s = self._origin_s, due * self.period_s
        # As little as possible between waking up and reading the clock: it would all be lateness.
        while (late_s := self.time.now() - origin_s - time_s) < 0:
            self.time.sleep(-late_s if late_s > -2 * NAP_S else -late_s - NAP_S)
        if late_s > STANDSTILL_S:  # while it slept; whoever pauses the clock now knows of it
            self.standstill = Standstill(late_s, self.time.now())
        return Tick(due, time_s, late_s)


def request_realtime_priority(priority: int = 10) -> bool:
    """Ask the kernel for SCHED_FIFO for this thread; True if it was granted.

    A higher priority is kept; child programs and threads do not inherit it. On a busy machine it lowers the
    maximum lateness from tens of milliseconds to a few. Needs root or rtprio.
    """
    try:
        if os.sched_getparam(0).sched_priority > priority:
            return True
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except (AttributeError, OSError):
        return False
    return True


@contextmanager
def realtime_priority() -> Iterator[bool]:
    """Hold the priority of `request_realtime_priority` for a while; yields whether it was granted.

    Long computations keep their usual priority: threads of equal real-time priority do not interrupt each
    other.
    """
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
    except (AttributeError, OSError):
        yield False
        return
    granted = request_realtime_priority()
    try:
        yield granted
    finally:
        if granted:
            policy, parameters = before
            with suppress(OSError):  # of a higher one set from outside
                # Only root may take back that children begin with the usual priority.
                os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, parameters)
