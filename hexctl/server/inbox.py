"""Bounded queue between the network and the thread that moves the robot."""

from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from threading import Lock
from typing import Any

from hexctl.time_source import WALL_TIME, TimeSource

#: Limit for each kind: a flood of one kind displaces no other.
MOST_WAITING = {
    "command": 16,
    "pose": 8,
    "ros": 8,
    "lease": 8,
    "estop": 8,
    "describe": 8,
    "failure": 4,
    "state": 1,  # to ROS: the newest replaces the one before
}

#: Queries: surplus ones are dropped, and the client repeats them. Of other kinds, the oldest are dropped.
QUERIES = ("lease", "estop", "describe", "failure")


@dataclass(frozen=True, slots=True, eq=False)
class Arrival:
    """A message that arrived: its kind in `KeyMap`, a Zenoh sample or query, and its time."""

    kind: str
    item: Any
    at_s: float


class Inbox:
    """Bounded queue from Zenoh's threads to the robot's thread.

    A lock wakes the reader: a condition variable costs two wake-ups, a fifth of a round trip. In CPython 3.11
    `queue.SimpleQueue.get` can block forever if a signal interrupts it as its timeout expires.
    """

    def __init__(self, *, time: TimeSource = WALL_TIME) -> None:
        self._waiting: deque[Arrival] = deque()
        self._bell = Lock()
        self._bell.acquire()  # held until the first put
        self._time = time
        self.overflowed = 0

    def put(self, kind: str, item: Any) -> None:
        """Append an arrival, except a surplus query; never waits."""
        alike = [one for one in list(self._waiting) if one.kind == kind]
        if len(alike) >= MOST_WAITING[kind]:
            self.overflowed += 1
            if kind in QUERIES:
                return
            with suppress(ValueError):  # taken in this moment
                self._waiting.remove(alike[0])
        self._waiting.append(Arrival(kind, item, self._time.now()))
        with suppress(RuntimeError):  # already released
            self._bell.release()

    def take(self, timeout_s: float) -> Arrival | None:
        """Oldest arrival, or None after the timeout."""
        deadline_s = self._time.now() + timeout_s
        while (arrival := self._oldest()) is None:
            left_s = deadline_s - self._time.now()
            if left_s <= 0 or not self._bell.acquire(timeout=left_s):
                return self._oldest()
        return arrival

    def _oldest(self) -> Arrival | None:
        try:
            return self._waiting.popleft()
        except IndexError:
            return None
