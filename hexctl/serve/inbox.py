"""Where everything from the network waits for the one thread that may move the robot."""

import threading
import time
from collections import deque
from dataclasses import dataclass
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

    Attributes:
        overflowed: arrivals pushed out unread so far.
    """

    def __init__(self, capacity: int = CAPACITY) -> None:
        self._waiting: deque[Arrival] = deque()
        self._capacity = capacity
        self._changed = threading.Condition()
        self.overflowed = 0

    def put(self, kind: str, item: Any) -> None:
        """Keep an arrival; never waits for more than a moment."""
        arrival = Arrival(kind, item, time.monotonic())
        with self._changed:
            if len(self._waiting) >= self._capacity:
                self._waiting.popleft()
                self.overflowed += 1
            self._waiting.append(arrival)
            self._changed.notify()

    def take(self, patience_s: float) -> Arrival | None:
        """Return the oldest arrival, waiting for one for a while; None when none came."""
        with self._changed:
            if not self._waiting and patience_s > 0:
                self._changed.wait(patience_s)
            return self._waiting.popleft() if self._waiting else None
