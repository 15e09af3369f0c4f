"""Where everything from the network waits for the one thread that may move the robot."""

import time
from contextlib import suppress
from dataclasses import dataclass
from queue import Empty, SimpleQueue
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
        # One wake-up for each arrival; a condition variable costs two, and with them a fifth of a round trip.
        self._waiting: SimpleQueue[Arrival] = SimpleQueue()
        self._capacity = capacity
        self.overflowed = 0

    def put(self, kind: str, item: Any) -> None:
        """Keep an arrival; never waits."""
        while self._waiting.qsize() >= self._capacity:
            with suppress(Empty):
                self._waiting.get_nowait()
                self.overflowed += 1
        self._waiting.put(Arrival(kind, item, time.monotonic()))

    def take(self, patience_s: float) -> Arrival | None:
        """Return the oldest arrival, waiting for one for a while; None when none came."""
        try:
            return self._waiting.get(patience_s > 0, max(0.0, patience_s))
        except Empty:
            return None
