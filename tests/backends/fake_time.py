"""Simulated time for tests: it advances only by what the thread that made it does."""

import threading

from hexctl.backends.clock import PERIOD_S, WallClock
from hexctl.time_source import TimeSource

#: How often other threads look at the time, in real seconds.
LOOK_S = 0.0005


class FakeTime(TimeSource):
    """A time source whose time passes only while its own thread sleeps, waits or works.

    Other threads that sleep or wait on it go on once that thread has advanced it far enough.

    Attributes:
        now_s: the time.
        sleeps: how long each sleep of its own thread was asked to be.
        early_share: the share of a sleep that really passes before it returns.
        stopped_s: for how long the program is stopped in its next sleep.
    """

    def __init__(self, now_s: float = 1000.0, early_share: float = 1.0) -> None:
        self.now_s = now_s
        self.early_share = early_share
        self.stopped_s = 0.0
        self.sleeps: list[float] = []
        self._owner = threading.get_ident()

    def now(self) -> float:
        """The time."""
        return self.now_s

    def sleep(self, duration_s: float) -> None:
        """Advance the time; never by less than a nanosecond, the resolution of real clocks."""
        if duration_s < 0:
            raise ValueError("sleep length must be non-negative")
        if threading.get_ident() != self._owner:
            self.wait(threading.Event(), duration_s)
            return
        self.sleeps.append(duration_s)
        self.now_s += max(duration_s * self.early_share, 1e-9) + self.stopped_s
        self.stopped_s = 0.0

    def wait(self, event: threading.Event | threading.Condition, timeout_s: float | None = None) -> bool:
        """Wait for an event or a condition; its own thread advances the time unless that is set."""
        if timeout_s is None:
            return event.wait()
        if threading.get_ident() == self._owner:
            if event.wait(0.0):
                return True
            self.sleep(timeout_s)
            return event.wait(0.0)
        until_s = self.now_s + timeout_s
        while not (came := event.wait(LOOK_S)) and self.now_s < until_s:
            pass
        return came

    def work(self, duration_s: float) -> None:
        """Advance the time by the work of a tick."""
        self.now_s += duration_s

    def clock(self, period_s: float = PERIOD_S) -> WallClock:
        """A wall clock on this time."""
        return WallClock(period_s, time=self)
