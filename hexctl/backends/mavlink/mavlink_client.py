"""A MAVLink servo board as LegServos; docs/reference/mavlink.md specifies the board's side."""

import math
import threading
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.backends.clock import Clock, WallClock, request_realtime_priority
from hexctl.backends.mavlink import mavlink_messages
from hexctl.backends.mavlink.codec import Codec, Frame, stamp_file_of
from hexctl.backends.mavlink.mavlink_transport import (
    Address,
    LinkCounters,
    MavlinkLink,
    SequenceCount,
    lock_port,
    open_port,
    parse_port,
)
from hexctl.backends.port_thread import reason_of
from hexctl.backends.ticked_servos import MappedServos
from hexctl.errors import MessageError, RobotFaultError
from hexctl.robot.model import Robot
from hexctl.robot.servos.servo_map import ServoMap
from hexctl.types import FloatArray, RobotState
from hexctl.waiting import wait_for
from hexctl.wire.transit_delay import BOARD_DRIFT, StampCheck

#: How long a board may take for its first heartbeat, and then for its first servo positions.
CONNECT_TIMEOUT_S = 3.0

#: A pose or contacts this much older than the outputs are not used.
STALE_POSE_S = 0.2

#: A battery reading older than this is not used.
STALE_BATTERY_S = 10.0

#: How long an error text of the board is a fault.
ERROR_TEXT_S = 2.0

#: Where between two states of the board the ticks of this end fall: as far from both as possible.
PHASE = 0.5

#: After this silence a board may hold before the next override, and heartbeats announce this end for so
#: long: otherwise it takes the first overrides for late ones.
PAUSE_S, RESUMES_S = 0.1, 0.4

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
        self._stamps: dict[str, tuple[float, StampCheck]] = {}
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
        self._link.codec.keep_stamp()

    def newest(self, name: str) -> Stamped | None:
        """Newest value with this name, or None before the first."""
        return self._newest.get(name)

    def _run(self) -> None:
        request_realtime_priority()  # a state that waits for the processor is late too
        beat_at_s = self._link.time.now()
        while not self._stopping.is_set() and self.error is None:
            try:
                arrivals = self._link.receive(RECEIVE_TIMEOUT_S)
                for frame, sender, at_s in arrivals:
                    self._take(frame, sender, at_s)
            except OSError as error:
                self.error = error
                break
            if len(arrivals) >= MOST_AT_ONCE:
                # At its priority this thread would keep others from the processor.
                self._link.time.sleep(FLOODED_S)
            self.counters.malformed = self._link.codec.malformed
            self.counters.dropped = self._link.port.dropped
            if self._link.time.now() >= beat_at_s:
                self._beat(mavlink_messages.ACTIVE)
                period_s = SEARCH_PERIOD_S if self.peer is None else HEARTBEAT_PERIOD_S
                beat_at_s = self._link.time.now() + period_s

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

    def _take(self, frame: Frame, sender: Address, at_s: float) -> None:
        peer = Peer(frame.system, frame.component, sender)
        if self.peer is None and frame.kind == "HEARTBEAT":
            self._meet(frame, peer)
        if self.peer != peer:
            self.counters.foreign += 1
            return
        if not self._sequence.in_order(frame.sequence, at_s):
            self.counters.out_of_order = self._sequence.out_of_order
            return
        self.counters.received += 1
        self.counters.lost = self._sequence.lost
        if not self._is_in_time(frame, at_s):
            self.counters.late += 1
            return
        try:
            self._keep(frame.kind, frame.message, at_s)
        except MessageError:
            self.counters.refused += 1

    def _is_in_time(self, frame: Frame, at_s: float) -> bool:
        """Whether a frame is not late by its stamp; frames are in order, so an earlier stamp is a restart."""
        stamp_s = mavlink_messages.stamp_s(frame.message)
        if stamp_s is None:
            return True
        before_s, check = self._stamps.get(frame.kind, (math.inf, StampCheck()))
        if stamp_s < before_s:
            check = StampCheck(drift=BOARD_DRIFT)
        self._stamps[frame.kind] = stamp_s, check
        return check.admits(stamp_s, at_s)

    def _meet(self, frame: Frame, peer: Peer) -> None:
        if peer.system == mavlink_messages.CONTROLLER_SYSTEM:
            return
        if frame.message.type in mavlink_messages.BOARD_TYPES:
            self.peer = peer
        else:
            self.wrong_type = int(frame.message.type)

    def _keep(self, kind: str, message: Any, at_s: float) -> None:
        if kind in READERS:
            name, read = READERS[kind]
            self._newest[name] = Stamped(read(message), at_s)
        elif kind == "HEARTBEAT":
            self._newest["heartbeat"] = Stamped(int(message.system_status), at_s)
        elif kind == "NAMED_VALUE_INT":
            name = mavlink_messages.name_of(message)
            if name == mavlink_messages.MEASURED_NAME:
                self._newest["measured"] = Stamped(message.value == 1, at_s)
            elif name == mavlink_messages.CONTACTS_NAME:
                self._newest["contacts"] = Stamped(mavlink_messages.contacts_of(message), at_s)
        elif kind == "STATUSTEXT" and message.severity <= ERROR_SEVERITY:
            self._newest["error"] = Stamped(mavlink_messages.name_of(message), at_s)


class MavlinkServos(MappedServos[ServoMap, LinkCounters]):
    """Client of a servo board.

    Each `write` sends one RC_CHANNELS_OVERRIDE in whole microseconds, after the pulse limits. States are an
    echo unless the board measures positions; their age grows while it is silent. After `close` the board
    holds the pose.

    Args:
        port: `udpout:HOST:PORT`, `udpin:HOST:PORT`, or a serial device.
        clock: a wall clock in phase with the board unless given.
        signing_key: 32 bytes that sign all frames, or None.
    """

    what = "the servo board"

    def __init__(
        self,
        robot: Robot | str | Path,
        *,
        servo_map: ServoMap,
        port: str,
        clock: Clock | None = None,
        signing_key: bytes | None = None,
    ) -> None:
        # The phase of a given clock is not changed.
        self._wall = WallClock() if clock is None else None
        super().__init__(
            robot,
            servo_map=servo_map,
            port=port,
            counters=LinkCounters(),
            clock=clock or self._wall or WallClock(),
        )
        self._address = parse_port(port)
        self._signing_key = signing_key
        self._written_at_s = self._resumed_at_s = -math.inf

    def _open_all(self, opening: ExitStack) -> None:
        opening.callback(lock_port(self._address, text=self._port).release)
        port = open_port(self._address, text=self._port)
        opening.callback(port.close)
        codec = Codec(
            mavlink_messages.CONTROLLER_SYSTEM,
            mavlink_messages.CONTROLLER_COMPONENT,
            signing_key=self._signing_key,
            stamp_file=stamp_file_of(self._signing_key),
        )
        self._link = MavlinkLink(port, codec, time=self._clock.time)
        self._receiver = Receiver(self._link, self.counters)
        self._battery_at_s, self._voltages_v = -math.inf, tuple[float, ...]()
        self._receiver.start()
        opening.callback(self._receiver.stop)
        self._peer = self._await(lambda: self._receiver.peer, self._no_heartbeat)
        outputs = self._await(
            lambda: self._receiver.newest("outputs"),
            f"the servo board at {self._port} sends no ACTUATOR_OUTPUT_STATUS with pulses in microseconds; "
            "see docs/reference/mavlink.md",
        )
        if self._wall is not None:
            self._wall.begin(outputs.at_s - self._clock.period_s * PHASE)  # between the board's states

    def disable_torque(self) -> bool:
        """Release all servos until the next targets."""
        self._check_connected()
        self._send(mavlink_messages.release(self._peer.system, self._peer.component))
        return True

    def _send_targets(self, positions_rad: FloatArray, *, clips: bool) -> None:
        self.counters.clipped += clips
        if self._resumes():
            self._send(self._receiver.heartbeat())
        pulses = self._map.to_us(positions_rad)
        self._send(mavlink_messages.override(pulses, self._peer.system, self._peer.component))

    def _resumes(self) -> bool:
        """Whether a write follows a recent pause; notes the write."""
        now_s = self._clock.time.now()
        if now_s - self._written_at_s > PAUSE_S:
            self._resumed_at_s = now_s
        self._written_at_s = now_s
        return now_s - self._resumed_at_s < RESUMES_S

    def _send(self, message: object) -> None:
        self._check_port()
        try:
            self._link.send(message, self._peer.address)
        except OSError as error:
            raise RobotFaultError(self._gone(reason_of(error))) from error

    def _check_port(self) -> None:
        if self._receiver.error is not None:
            raise RobotFaultError(self._gone(reason_of(self._receiver.error)))

    def _await(self, find: Callable[[], Any], silence: str | Callable[[], str]) -> Any:
        """What the board is about to send; raises RobotFaultError with `silence` if it does not come."""

        def found() -> Any:
            self._check_port()
            return find()

        return wait_for(found, CONNECT_TIMEOUT_S, silence, poll_s=0.002, time=self._clock.time)

    def _no_heartbeat(self) -> str:
        if self._receiver.wrong_type is not None:
            return (
                f"a MAVLink system of type {self._receiver.wrong_type} is at {self._port}, no servo "
                "board; allowed: MAV_TYPE 0 or 18, see docs/reference/mavlink.md"
            )
        if self._link.codec.of_mavlink_1:
            return f"the board at {self._port} speaks MAVLink 1; set its port to MAVLink 2"
        heard = f"{self._link.received_bytes} bytes came, {self.counters.malformed} runs of them no MAVLink 2"
        signed = "has it no signing key"
        if self._signing_key is not None:
            signed = f"has it the same signing key, and is this computer's clock right ({datetime.now():%c})"
        return (
            f"no heartbeat of a servo board at {self._port} within {CONNECT_TIMEOUT_S:g} s ({heard}); "
            f"is it on, are port and baud rate right, {signed}?"
        )

    def _newest(self) -> RobotState:
        self._check_port()
        now_s = self._clock.time.now()
        outputs = self._receiver.newest("outputs")
        assert outputs is not None  # noqa: S101  connect waited for it
        age_s = max(0.0, now_s - outputs.at_s)
        told = self._receiver.newest("measured")
        measured = told is not None and bool(told.value)
        position, quaternion = self._pose(outputs.at_s)
        battery = self._battery(now_s)
        fault = self._fault(now_s)
        contacts = _fresh(self._receiver.newest("contacts"), outputs.at_s, STALE_POSE_S)
        return RobotState(
            self._positions(outputs.value, measured=measured),
            stamp_s=max(0.0, self._clock.now_s - age_s),
            measured=measured,
            base_position_world=position,
            base_quaternion_world=quaternion,
            foot_contacts=None if contacts is None else contacts.value,
            age_s=age_s,
            healthy=fault is None,
            fault=fault,
            battery_v=battery.voltage_v,
            low_battery_v=self._map.low_battery_v,
            battery_share=battery.share,
        )

    def _positions(self, outputs: mavlink_messages.Outputs, *, measured: bool) -> FloatArray:
        """Joint angles; an undriven servo without feedback has its last target, else the stance."""
        told = self._map.to_rad(outputs.pulses_us)
        unknown = np.isnan(told)
        if not measured:
            unknown |= ~outputs.active[self._map.channels - 1]
        return np.where(unknown, self._sent_rad, told)

    def _pose(self, outputs_at_s: float) -> tuple[FloatArray | None, FloatArray | None]:
        """Position and orientation; each None once outputs keep arriving without it, but not in silence."""
        if (odometry := _fresh(self._receiver.newest("odometry"), outputs_at_s, STALE_POSE_S)) is not None:
            return odometry.value.position_world, odometry.value.quaternion_world
        position = _fresh(self._receiver.newest("position"), outputs_at_s, STALE_POSE_S)
        attitude = _fresh(self._receiver.newest("attitude"), outputs_at_s, STALE_POSE_S)
        return None if position is None else position.value, None if attitude is None else attitude.value

    def _battery(self, now_s: float) -> mavlink_messages.Battery:
        """The battery, with the higher voltage of the last two messages: a single one may be wrong.

        BATTERY_STATUS has priority over SYS_STATUS.
        """
        for name in ("battery", "system"):
            reading = _fresh(self._receiver.newest(name), now_s, STALE_BATTERY_S)
            if reading is not None and reading.value.voltage_v is not None:
                if self._battery_at_s != reading.at_s:
                    self._battery_at_s = reading.at_s
                    self._voltages_v = (*self._voltages_v[-1:], reading.value.voltage_v)
                return mavlink_messages.Battery(max(self._voltages_v), reading.value.share)
        return mavlink_messages.Battery(None, None)

    def _fault(self, now_s: float) -> str | None:
        text = _fresh(self._receiver.newest("error"), now_s, ERROR_TEXT_S)
        if text is not None:
            return f"the board reports: {text.value}"
        state = self._receiver.newest("heartbeat")
        if state is not None and state.value >= mavlink_messages.EMERGENCY:
            return f"the board reports MAV_STATE {state.value}"
        return None


def _fresh(stamped: Stamped | None, now_s: float, within_s: float) -> Stamped | None:
    return stamped if stamped is not None and now_s - stamped.at_s <= within_s else None
