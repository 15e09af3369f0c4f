"""Simulated time for tests: it advances only by what the thread that made it does."""

import math
import threading
import time
from dataclasses import dataclass

from hexctl.backends.clock import PERIOD_S, WallClock
from hexctl.time_source import TimeSource

#: How often threads look at the simulated time, and how long they may work between two waits, in real s.
LOOK_S, WORK_S = 0.0005, 1.0

#: How long a new thread may take to its first wait; one that takes longer never waits on this time.
FIRST_S = 0.3


@dataclass(frozen=True)
class _Wait:
    """A thread that waits for an event until a time."""

    event: threading.Event | threading.Condition
    until_s: float


class FakeTime(TimeSource):
    """A time source whose time passes only while its own thread sleeps, waits or works.

    Other threads that sleep or wait on it are run on the way, each at its time.

    Attributes:
        now_s: the time.
        early_share: the share of a sleep that really passes before it returns.
        stopped_s: for how long the program is stopped in its next sleep.
    """

    def __init__(self, now_s: float = 1000.0, early_share: float = 1.0) -> None:
        self.now_s = now_s
        self.early_share = early_share
        self.stopped_s = 0.0
        self._owner = threading.current_thread()
        self._others: dict[threading.Thread, _Wait | None] = {}  # None while one works
        self._since: dict[threading.Thread, float] = dict.fromkeys(threading.enumerate(), -math.inf)
        self._news = threading.Condition()  # that the time has passed, or a thread has begun to wait

    def now(self) -> float:
        """The time."""
        return self.now_s

    def sleep(self, duration_s: float) -> None:
        """Advance the time; never by less than a nanosecond, the resolution of real clocks."""
        if duration_s < 0:
            raise ValueError("sleep length must be non-negative")
        if threading.current_thread() is not self._owner:
            self._wait(threading.Event(), duration_s)
            return
        self._run_until(self.now_s + max(duration_s * self.early_share, 1e-9) + self.stopped_s)
        self.stopped_s = 0.0

    def wait(self, event: threading.Event | threading.Condition, timeout_s: float | None = None) -> bool:
        """Wait for an event or a condition; its own thread advances the time unless that is set."""
        if threading.current_thread() is not self._owner:
            return self._wait(event, math.inf if timeout_s is None else timeout_s)
        if timeout_s is None:
            return event.wait()
        if event.wait(0.0):
            return True
        self.sleep(timeout_s)
        return event.wait(0.0)

    def join(self, thread: threading.Thread) -> None:
        """Let a thread end; its own thread advances the time as far as that takes."""
        while thread.is_alive():
            if threading.current_thread() is self._owner:
                self._run_until(self.now_s + PERIOD_S)
            thread.join(LOOK_S)

    def work(self, duration_s: float) -> None:
        """Advance the time by the work of a tick."""
        self.now_s += duration_s

    def clock(self, period_s: float = PERIOD_S) -> WallClock:
        """A wall clock on this time."""
        return WallClock(period_s, time=self)

    def _wait(self, event: threading.Event | threading.Condition, timeout_s: float) -> bool:
        """Wait in another thread than its own; as in `sleep`, some time passes unless none is to."""
        if timeout_s <= 0:
            return event.wait(0.0)
        this, until_s = threading.current_thread(), self.now_s + max(timeout_s, 1e-9)
        with self._news:
            self._others[this] = _Wait(event, until_s)
            self._news.notify_all()
        try:
            while not (came := self._look(event)) and self.now_s < until_s:
                pass
        finally:
            self._others[this] = None
        return came

    def _look(self, event: threading.Event | threading.Condition) -> bool:
        """Whether an event comes before there are news or, as others may set it, the next look."""
        if isinstance(event, threading.Condition):
            return event.wait(LOOK_S)
        with self._news:
            if not event.is_set():
                self._news.wait(LOOK_S)
        return event.is_set()

    def _run_until(self, at_s: float) -> None:
        """Advance the time, and let other threads do what is due."""
        self._settle()
        while (due_s := min((each.until_s for each in self._waits()), default=math.inf)) <= at_s:
            self.now_s = max(self.now_s, due_s)
            self._settle()
        self.now_s = at_s

    def _settle(self) -> None:
        """Let other threads work until they wait for a later time; one that does not is left behind."""
        given_up_s = time.monotonic() + WORK_S
        with self._news:
            self._news.notify_all()
            while self._busy() and time.monotonic() < given_up_s:
                self._news.wait(LOOK_S)

    def _busy(self) -> bool:
        now_s = time.monotonic()
        for thread in threading.enumerate():
            if thread not in self._others and now_s - self._since.setdefault(thread, now_s) < FIRST_S:
                return True
        alive = [wait for thread, wait in list(self._others.items()) if thread.is_alive()]
        return any(wait is None or wait.until_s <= self.now_s or _is_set(wait.event) for wait in alive)

    def _waits(self) -> list[_Wait]:
        others = list(self._others.items())
        return [
            wait
            for thread, wait in others
            if wait is not None and wait.until_s > self.now_s and thread.is_alive()
        ]


def _is_set(event: threading.Event | threading.Condition) -> bool:
    return isinstance(event, threading.Event) and event.is_set()


class Standing(TimeSource):
    """Another time, on which nothing waits: simulated devices answer within the call that asks them."""

    def __init__(self, time: TimeSource) -> None:
        self._time = time

    def now(self) -> float:
        """The time of the other one."""
        return self._time.now()

    def sleep(self, duration_s: float) -> None:
        """Time passes elsewhere."""
