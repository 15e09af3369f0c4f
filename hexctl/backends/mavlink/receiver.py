"""The thread that receives from a servo board, and keeps its newest messages."""

import threading
from dataclasses import dataclass
from typing import Any

from hexctl.backends.clock import request_realtime_priority
from hexctl.backends.mavlink import mavlink_messages
from hexctl.backends.mavlink.mavlink_transport import (
    Address,
    Arrival,
    LinkCounters,
    MavlinkLink,
    SequenceCount,
)
from hexctl.errors import MessageError

#: Period of heartbeats before and after a board has answered.
SEARCH_PERIOD_S, HEARTBEAT_PERIOD_S = 0.2, 1.0

#: How long the receiving thread blocks before it checks whether a heartbeat is due.
RECEIVE_TIMEOUT_S = 0.05

#: Severity of a STATUSTEXT from which it is a fault: error, critical, alert, emergency.
ERROR_SEVERITY = 3

#: Number of frames in a burst that counts as a flood, and the pause after it.
MOST_AT_ONCE, FLOODED_S = 32, 0.005

#: Stored messages by kind: attribute and decoder.
READERS = {
    "ACTUATOR_OUTPUT_STATUS": ("outputs", mavlink_messages.outputs_of),
    "ATTITUDE": ("attitude", mavlink_messages.orientation_of),
    "ATTITUDE_QUATERNION": ("attitude", mavlink_messages.orientation_of),
    "LOCAL_POSITION_NED": ("position", mavlink_messages.position_of),
    "ODOMETRY": ("odometry", mavlink_messages.pose_of),
    "BATTERY_STATUS": ("battery", mavlink_messages.battery_of),
    "SYS_STATUS": ("system", mavlink_messages.battery_of),
}


@dataclass(frozen=True, slots=True)
class Peer:
    """The board at the other end."""

    system: int
    component: int
    address: Address


@dataclass(frozen=True, slots=True)
class Stamped:
    """A received value, and when it arrived."""

    value: Any
    at_s: float


class Receiver:
    """Receives from one board in a thread, and sends it heartbeats.

    The first system whose heartbeat has the type of a servo board is `peer`; others are counted and dropped.
    `wrong_type` is the MAV_TYPE of a received system other than a servo board, or None.
    """

    def __init__(self, link: MavlinkLink, counters: LinkCounters) -> None:
        self._link = link
        self.counters = counters
        self.peer: Peer | None = None
        self.wrong_type: int | None = None
        self.error: OSError | None = None
        self._newest: dict[str, Stamped] = {}
        self._sequence = SequenceCount()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="mavlink", daemon=True)

    def start(self) -> None:
        """Begin to receive and to send heartbeats."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread and announce the end to the board."""
        self._stopping.set()
        self._link.time.join(self._thread)
        if self.peer is not None and self.error is None:
            self._beat(mavlink_messages.POWEROFF)

    def newest(self, name: str) -> Stamped | None:
        """Newest value with this name, or None before the first."""
        return self._newest.get(name)

    def _run(self) -> None:
        request_realtime_priority()  # a state that waits for the processor is late too
        beat_at_s = self._link.time.now()
        while not self._stopping.is_set() and self.error is None:
            try:
                arrivals = self._link.receive(RECEIVE_TIMEOUT_S)
                for arrival in arrivals:
                    self._take(arrival)
            except OSError as error:
                self.error = error
                break
            if len(arrivals) >= MOST_AT_ONCE:
                self._link.time.sleep(
                    FLOODED_S
                )  # at its priority this thread would keep others from the processor
            self.counters.malformed, self.counters.dropped = self._link.malformed, self._link.dropped
            if self._link.time.now() >= beat_at_s:
                self._beat(mavlink_messages.ACTIVE)
                beat_at_s = self._link.time.now() + (
                    SEARCH_PERIOD_S if self.peer is None else HEARTBEAT_PERIOD_S
                )

    def _beat(self, state: int) -> None:
        try:
            self._link.send(self.heartbeat(state), None if self.peer is None else self.peer.address)
        except OSError as error:
            self.error = error

    def heartbeat(self, state: int = mavlink_messages.ACTIVE) -> Any:
        """Heartbeat that echoes the age of the board's newest outputs."""
        outputs = self.newest("outputs")
        return mavlink_messages.controller_heartbeat(
            state, board_ms=0 if outputs is None else outputs.value.board_ms
        )

    def _take(self, arrival: Arrival) -> None:
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
        frame = arrival.frame
        if frame.system == mavlink_messages.CONTROLLER_SYSTEM:
            return
        if frame.message.type not in mavlink_messages.BOARD_TYPES:
            self.wrong_type = int(frame.message.type)
            return
        self.peer = Peer(frame.system, frame.component, arrival.sender)

    def _keep(self, kind: str, message: Any, at_s: float) -> None:
        if kind in READERS:
            name, read = READERS[kind]
            self._newest[name] = Stamped(read(message), at_s)
        elif kind == "HEARTBEAT":
            self._newest["heartbeat"] = Stamped(int(message.system_status), at_s)
        elif (
            kind == "NAMED_VALUE_INT" and mavlink_messages.name_of(message) == mavlink_messages.MEASURED_NAME
        ):
            self._newest["measured"] = Stamped(message.value == 1, at_s)
        elif kind == "STATUSTEXT" and message.severity <= ERROR_SEVERITY:
            self._newest["error"] = Stamped(mavlink_messages.name_of(message), at_s)
