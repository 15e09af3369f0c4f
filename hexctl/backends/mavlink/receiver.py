"""The controller's ear: a thread that stamps what the board says as it comes, and beats the heart."""

import threading
import time
from dataclasses import dataclass, fields
from typing import Any

from hexctl.backends.mavlink import messages
from hexctl.backends.mavlink.link import Arrival, MavlinkLink
from hexctl.backends.mavlink.port import Address
from hexctl.backends.mavlink.sequence import SequenceCount
from hexctl.errors import MessageError

#: Between two heartbeats, before and after a board has answered.
HAIL_S, BEAT_S = 0.2, 1.0

#: How long the thread waits for something before it looks whether a heartbeat is due.
LOOK_S = 0.05

#: Severity of a STATUSTEXT from which it is a fault: error, critical, alert, emergency.
ERROR_SEVERITY = 3


@dataclass(frozen=True, slots=True)
class Peer:
    """The board at the other end."""

    system: int
    component: int
    address: Address


@dataclass(frozen=True, slots=True)
class Stamped:
    """Something that came, and when, on time.monotonic."""

    value: Any
    at_s: float


@dataclass(slots=True)
class LinkCounters:
    """What the link did so far.

    Attributes:
        received: messages of the board.
        lost: messages of the board that never came, by their sequence numbers.
        out_of_order: that came after a later one, or twice; they are not used.
        refused: that hold numbers which cannot be.
        foreign: messages of others.
        malformed: runs of bytes that were no message of ours: noise, MAVLink 1, unsigned, another dialect.
        dropped: messages of ours that the port could not take.
        clipped: commands that a pulse limit changed.
    """

    received: int = 0
    lost: int = 0
    out_of_order: int = 0
    refused: int = 0
    foreign: int = 0
    malformed: int = 0
    dropped: int = 0
    clipped: int = 0

    def as_json(self) -> dict[str, int]:
        """Return all counts."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


#: What is kept of each message, by its kind: under which name, and how it is read.
READERS = {
    "ACTUATOR_OUTPUT_STATUS": ("outputs", messages.outputs_of),
    "ATTITUDE": ("attitude", messages.orientation_of),
    "ATTITUDE_QUATERNION": ("attitude", messages.orientation_of),
    "LOCAL_POSITION_NED": ("position", messages.position_of),
    "ODOMETRY": ("odometry", messages.pose_of),
    "BATTERY_STATUS": ("battery", messages.battery_of),
    "SYS_STATUS": ("system", messages.battery_of),
}


class Receiver:
    """Hears one board from `start` to `stop`, and tells it once a second that somebody is there.

    The first system that beats as a servo board may is the board; everything from others is counted and
    dropped.

    Attributes:
        peer: the board, or None before its first heartbeat.
        wrong_type: MAV_TYPE of a system that was heard and is no servo board, or None.
        error: why the port has gone, or None.
        counters: what came.
    """

    def __init__(self, link: MavlinkLink, counters: LinkCounters) -> None:
        self._link = link
        self.counters = counters
        self.peer: Peer | None = None
        self.wrong_type: int | None = None
        self.error: OSError | None = None
        self._newest: dict[str, Stamped] = {}
        self._sequence = SequenceCount()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="mavlink", daemon=True)

    def start(self) -> None:
        """Begin to hear and to hail."""
        self._thread.start()

    def stop(self) -> None:
        """Say goodbye and end the thread."""
        self._over.set()
        self._thread.join()
        if self.peer is not None and self.error is None:
            self._beat(messages.POWEROFF)

    def newest(self, name: str) -> Stamped | None:
        """Return the newest of what is kept under a name, or None before the first."""
        return self._newest.get(name)

    def _run(self) -> None:
        beat_at_s = time.monotonic()
        while not self._over.is_set() and self.error is None:
            try:
                for arrival in self._link.receive(LOOK_S):
                    self._take(arrival)
            except OSError as error:
                self.error = error
            self.counters.malformed, self.counters.dropped = self._link.malformed, self._link.dropped
            if time.monotonic() >= beat_at_s:
                self._beat(messages.ACTIVE)
                beat_at_s = time.monotonic() + (HAIL_S if self.peer is None else BEAT_S)

    def _beat(self, state: int) -> None:
        try:
            self._link.send(
                messages.controller_heartbeat(state), None if self.peer is None else self.peer.address
            )
        except OSError as error:
            self.error = error

    def _take(self, arrival: Arrival) -> None:
        """Keep what the board says; count everything else."""
        frame = arrival.frame
        if self.peer is None and frame.kind == "HEARTBEAT":
            self._meet(arrival)
        if self.peer != Peer(frame.system, frame.component, arrival.sender):
            self.counters.foreign += 1
            return
        if not self._sequence.in_order(frame.sequence, arrival.at_s):
            self.counters.out_of_order = self._sequence.out_of_order
            return
        self.counters.received += 1
        self.counters.lost = self._sequence.lost
        try:
            self._keep(frame.kind, frame.message, arrival.at_s)
        except MessageError:
            self.counters.refused += 1

    def _meet(self, arrival: Arrival) -> None:
        """Take whoever beats for the board if it can be one."""
        frame = arrival.frame
        if frame.system == messages.CONTROLLER_SYSTEM:
            return
        if frame.message.type not in messages.BOARD_TYPES:
            self.wrong_type = int(frame.message.type)
            return
        self.peer = Peer(frame.system, frame.component, arrival.sender)

    def _keep(self, kind: str, message: Any, at_s: float) -> None:
        if kind in READERS:
            name, read = READERS[kind]
            self._newest[name] = Stamped(read(message), at_s)
        elif kind == "HEARTBEAT":
            self._newest["heartbeat"] = Stamped(int(message.system_status), at_s)
        elif kind == "NAMED_VALUE_INT" and messages.name_of(message) == messages.MEASURED_NAME:
            self._newest["measured"] = Stamped(message.value == 1, at_s)
        elif kind == "STATUSTEXT" and message.severity <= ERROR_SEVERITY:
            self._newest["error"] = Stamped(messages.name_of(message), at_s)
