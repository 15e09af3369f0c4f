"""Clocks: when the next control tick is due. The clock belongs to the servos."""

import math
import os
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

#: The control period of hexctl, 50 Hz.
PERIOD_S = 0.02

#: After a long sleep the processor wakes up slowly; a second one as short as this ends on time.
NAP_S = 0.0003


@dataclass(frozen=True, slots=True)
class Tick:
    """One point of a clock's grid.

    Attributes:
        index: number of the grid point; it grows by more than one when points were missed.
        time_s: time of the grid point since the clock began, index * period.
        late_s: how long after the grid point the tick began.
    """

    index: int
    time_s: float
    late_s: float = 0.0


class Clock(ABC):
    """Gives one tick per control period.

    Attributes:
        period_s: time between two grid points.
        overruns: grid points missed so far because a tick took too long.
    """

    def __init__(self, period_s: float = PERIOD_S) -> None:
        self.period_s = period_s
        self.overruns = 0

    @abstractmethod
    def tick(self) -> Tick:
        """Wait for the next grid point, or make it come, and return it."""

    @property
    @abstractmethod
    def now_s(self) -> float:
        """Return the time since the clock began, on the axis of `Tick.time_s`."""

    @property
    def due_in_s(self) -> float:
        """Return how long the next `tick` would wait; 0 where it does not wait or nobody knows."""
        return 0.0

    @abstractmethod
    def rest(self) -> None:
        """Say that nobody wanted ticks until now: points missed before the next tick are no overruns."""


class WallClock(Clock):
    """Waits for the next point of an absolute grid on the wall.

    A tick that comes late by less than a period runs at once, and the grid stays where it is, so nothing
    drifts. A tick that misses whole grid points skips them and counts them as overruns: a robot must not be
    sent a burst of old targets.
    """

    def __init__(
        self,
        period_s: float = PERIOD_S,
        *,
        monotonic_s: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        super().__init__(period_s)
        self._monotonic_s = monotonic_s
        self._sleep = sleep
        self._origin_s: float | None = None
        self._index = 0
        self._rested = False

    @property
    def now_s(self) -> float:
        """Return the time since the first tick was asked for."""
        return 0.0 if self._origin_s is None else self._monotonic_s() - self._origin_s

    def begin(self, at_s: float) -> None:
        """Let the grid begin at a moment of its monotonic time, unless it has begun."""
        if self._origin_s is None:
            self._origin_s = at_s

    @property
    def due_in_s(self) -> float:
        """Return the time until the next grid point."""
        return 0.0 if self._origin_s is None else max(0.0, (self._index + 1) * self.period_s - self.now_s)

    def rest(self) -> None:
        """Count no overruns for the time until the next tick."""
        self._rested = True

    def tick(self) -> Tick:
        """Sleep until the next grid point and return it, skipping those already missed."""
        if self._origin_s is None:
            self._origin_s = self._monotonic_s()
        due = self._index + 1
        newest = math.floor(self.now_s / self.period_s)
        if newest > due:
            self.overruns += 0 if self._rested else newest - due
            due = newest
        self._rested = False
        self._index = due
        origin_s, time_s = self._origin_s, due * self.period_s
        # As little as possible between waking up and reading the clock: it would all be lateness.
        while (late_s := self._monotonic_s() - origin_s - time_s) < 0:
            self._sleep(-late_s if late_s > -2 * NAP_S else -late_s - NAP_S)
        return Tick(due, time_s, late_s)


def request_realtime_priority(priority: int = 10) -> bool:
    """Ask the kernel for SCHED_FIFO for this thread; return whether it was given.

    Programs started from here do not inherit it. On a busy machine it lowers the worst lateness from tens of
    milliseconds to a few. Needs root or rtprio.
    """
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except (AttributeError, OSError):
        return False
    return True


class CountedClock(Clock):
    """Passes everything on to the clock inside.

    Attributes:
        ticks: ticks so far.
    """

    def __init__(self, clock: Clock) -> None:
        super().__init__(clock.period_s)
        self._clock = clock
        self.ticks = 0

    @property
    def now_s(self) -> float:
        """Return the time of the clock inside."""
        return self._clock.now_s

    @property
    def due_in_s(self) -> float:
        """Return how long the next tick would wait."""
        return self._clock.due_in_s

    def rest(self) -> None:
        """Count no overruns until the next tick."""
        self._clock.rest()

    def tick(self) -> Tick:
        """Wait for the next tick of the clock inside and count it."""
        tick = self._clock.tick()
        self.ticks += 1
        self.overruns = self._clock.overruns
        return tick
