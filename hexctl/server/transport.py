"""A robot's Zenoh session, and the bounded queue from it to the thread that moves the robot."""

import socket
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import zenoh

from hexctl.time_source import WALL_TIME, TimeSource
from hexctl.wire.description import encode_json
from hexctl.wire.links import KeyMap, Link, Role
from hexctl.wire.zenoh_messages import prepare_codec
from hexctl.wire.zenoh_session import QUERYABLE, SUBSCRIBED, open_session

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
        self._bell = threading.Lock()
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


#: Pause between two looks at the connections: it takes longer to fill the buffers of one.
LINGER_LOOK_S = 0.1


def end_lingering(closing: threading.Event) -> None:
    """Let the kernel close connections, until an event.

    Zenoh waits up to 10 s (SO_LINGER) for a client that reads nothing, on one of the threads that serve all.
    """
    while not closing.wait(LINGER_LOOK_S):
        for number in _sockets():
            with suppress(OSError), socket.fromfd(number, socket.AF_INET, socket.SOCK_STREAM) as one:
                one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, bytes(8))


def _sockets() -> list[int]:
    """Open sockets of this process; none on a system that does not list them."""
    with suppress(OSError):
        return [int(file.name) for file in Path("/proc/self/fd").iterdir() if file.is_socket()]
    return []


#: Priority of each published kind of message.
PRIORITIES = {
    "joint_states": zenoh.Priority.REAL_TIME,
    "odom": zenoh.Priority.REAL_TIME,
    "battery": zenoh.Priority.DATA_LOW,
    "status": zenoh.Priority.DATA,
    "imu": zenoh.Priority.REAL_TIME,
    "truth": zenoh.Priority.DATA,
}


class Transport:
    """A robot's Zenoh session; its callbacks only put arrivals into the inbox.

    Before, on Zenoh's thread: `urgent` gets each payload at `estop`, `admits` the attachment of each command.
    """

    def __init__(
        self,
        link: Link,
        robot_name: str,
        inbox: Inbox,
        urgent: Callable[[bytes], None],
        admits: Callable[[bytes | None], bool],
    ) -> None:
        self._link = link
        self._admits = admits
        self.keys: KeyMap = link.keys(robot_name)
        self._inbox = inbox
        self._urgent = urgent
        self._session: zenoh.Session | None = None
        self._closing = threading.Event()
        self._publishers: dict[str, zenoh.Publisher] = {}

    def __enter__(self) -> Self:
        """Open the session; raises InputError for a bad link, RobotFaultError for an unusable address."""
        prepare_codec()
        self._session = open_session(self._link, Role.ROBOT, self.keys)
        threading.Thread(target=end_lingering, args=(self._closing,), name="lingering", daemon=True).start()
        try:
            self._declare(self._session)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self._closing.set()
        if self._session is not None:
            self._session.close()  # type: ignore[no-untyped-call]

    def publish(self, kind: str, payload: bytes, attachment: bytes | None = None) -> None:
        """Publish a message; never waits for a slow subscriber."""
        self._publishers[kind].put(payload, attachment=attachment)

    def reply(self, kind: str, query: Any, content: dict[str, Any]) -> None:
        """Answer a query with JSON, under the robot's own key, and release it."""
        try:
            query.reply(getattr(self.keys, kind), encode_json(content))
        except zenoh.ZError:
            pass  # the client has disconnected
        finally:
            query.drop()

    def _declare(self, session: zenoh.Session) -> None:
        for kind, priority in PRIORITIES.items():
            self._publishers[kind] = session.declare_publisher(
                getattr(self.keys, kind),
                congestion_control=zenoh.CongestionControl.DROP,
                priority=priority,
                express=True,
            )
        for kind in SUBSCRIBED:
            session.declare_subscriber(getattr(self.keys, kind), self._putter(kind))
        for kind in QUERYABLE:
            session.declare_queryable(getattr(self.keys, kind), self._putter(kind))

    def _putter(self, kind: str) -> Callable[[Any], None]:
        def put(item: Any) -> None:
            if kind == "estop":
                self._urgent(payload_of(item))
            if kind != "command" or self._admits(attachment_of(item)):
                self._inbox.put(kind, item)

        return put


def payload_of(item: Any) -> bytes:
    """Payload of a sample or a query; empty without one."""
    return bytes(item.payload) if item.payload is not None else b""


def attachment_of(item: Any) -> bytes | None:
    """Attachment of a sample, or None."""
    return bytes(item.attachment) if item.attachment is not None else None
