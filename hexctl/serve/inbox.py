"""Where everything from the network waits for the one thread that may move the robot."""

import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from threading import Lock
from typing import Any

#: More than a robot can be told in a tick; what does not fit pushes out the oldest.
CAPACITY = 64


@dataclass(frozen=True, slots=True)
class Arrival:
    """Something that came.

    Attributes:
        kind: the kind of message, as in `KeyMap`.
        item: a Zenoh sample or query.
        at_s: when, on time.monotonic.
    """

    kind: str
    item: Any
    at_s: float


class Inbox:
    """A bounded queue between Zenoh's threads, which only put, and the robot's, which takes.

    A lock is the bell: one wake-up for each arrival, where a condition variable costs two, and with them a
    fifth of a round trip. `queue.SimpleQueue` is no choice: interrupted by a signal just when its time was
    up, or woken for what somebody else took, its `get` waits for ever (CPython 3.11), and the robot with it.

    Attributes:
        overflowed: arrivals pushed out unread so far.
    """

    def __init__(self, capacity: int = CAPACITY) -> None:
        self._waiting: deque[Arrival] = deque()
        self._bell = Lock()
        self._bell.acquire()  # silent: held until somebody rings
        self._capacity = capacity
        self.overflowed = 0

    def put(self, kind: str, item: Any) -> None:
        """Keep an arrival; never waits."""
        while len(self._waiting) >= self._capacity:
            with suppress(IndexError):
                self._waiting.popleft()
                self.overflowed += 1
        self._waiting.append(Arrival(kind, item, time.monotonic()))
        with suppress(RuntimeError):  # it rings already
            self._bell.release()

    def take(self, patience_s: float) -> Arrival | None:
        """Return the oldest arrival, waiting for one for a while; None when none came."""
        until_s = time.monotonic() + patience_s
        while (arrival := self._oldest()) is None:
            left_s = until_s - time.monotonic()
            if left_s <= 0 or not self._bell.acquire(timeout=left_s):
                return self._oldest()
        return arrival

    def _oldest(self) -> Arrival | None:
        try:
            return self._waiting.popleft()
        except IndexError:
            return None
