"""A MAVLink servo board as LegServos; docs/firmware.md specifies the board's side."""

import threading
import time
from contextlib import ExitStack
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from hexctl.backends.base import LegServos, check_connected, check_targets
from hexctl.backends.clock import Clock, CountedClock, WallClock
from hexctl.backends.mavlink import messages
from hexctl.backends.mavlink.codec import Codec
from hexctl.backends.mavlink.transport import (
    Address,
    Arrival,
    MavlinkLink,
    SequenceCount,
    open_port,
    parse_port,
)
from hexctl.errors import MessageError, RobotFaultError
from hexctl.robot.model import Robot
from hexctl.robot.servo_map import ServoMap
from hexctl.types import FloatArray, JointTargets, RobotState
from hexctl.waiting import wait_for

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


#: How long a board may take to beat, and then to say where its servos are.
PATIENCE_S = 3.0

#: A pose this much older than the outputs is none.
STALE_POSE_S = 0.2

#: A battery reading older than this is none.
STALE_BATTERY_S = 10.0

#: How long an error text of the board is a fault.
ERROR_TEXT_S = 2.0

#: Where between two states of the board this end's ticks fall: as far from both as can be.
PHASE = 0.5

WHO = "the servo board"


class MavlinkServos(LegServos):
    """The controller's end of a servo board.

    One RC_CHANNELS_OVERRIDE per `write`, whole microseconds, pulse limits last. What comes back is an echo
    unless the board says that it measures. `read` gives one snapshot per tick; its age grows while
    the board is silent, which is for the guard to judge. `close` lets nothing go: the board holds the pose.

    Attributes:
        counters: what the link did so far.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        servo_map: ServoMap,
        port: str,
        clock: Clock | None = None,
        signing_key: bytes | None = None,
    ) -> None:
        self._robot = robot
        self._map = servo_map
        self._port_text, self._address = port, parse_port(port)
        # A clock that somebody else began runs on an axis of its own.
        self._wall = WallClock() if clock is None else None
        self._clock = CountedClock(clock or self._wall or WallClock())
        self._signing_key = signing_key
        self.counters = LinkCounters()
        self._opened: ExitStack | None = None
        self._assumed_rad = robot.stance_angles_rad.copy()
        self._snapshot: tuple[int, RobotState] | None = None

    @property
    def robot(self) -> Robot:
        """Return the robot that the servos belong to."""
        return self._robot

    @property
    def clock(self) -> Clock:
        """Return this end's clock."""
        return self._clock

    @property
    def link_counts(self) -> dict[str, int]:
        """Return `counters` as the interface wants them."""
        return self.counters.as_json()

    @property
    def servo_map(self) -> ServoMap:
        """Return the servo map in use."""
        return self._map

    def remap(self, servo_map: ServoMap) -> None:
        """Use another servo map from now on: the pulses stay, and mean other angles.

        A guard in front of these servos must be cleared at once, or it takes the change for a movement.
        """
        self._assumed_rad = servo_map.angles_rad(self._map.pulses_us(self._assumed_rad))
        self._map = servo_map
        self._snapshot = None

    def connect(self) -> None:
        """Open the port, hear the board's heartbeat and where its servos are.

        Raises RobotFaultError that says what to check.
        """
        if self._opened is not None:
            return
        with ExitStack() as opening:
            port = open_port(self._address, text=self._port_text)
            opening.callback(port.close)
            codec = Codec(
                messages.CONTROLLER_SYSTEM, messages.CONTROLLER_COMPONENT, signing_key=self._signing_key
            )
            self._link = MavlinkLink(port, codec)
            self._receiver = Receiver(self._link, self.counters)
            self._receiver.start()
            opening.callback(self._receiver.stop)
            self._peer = self._await_peer()
            self._await_outputs()
            self._snapshot = None
            self._opened = opening.pop_all()

    def read(self) -> RobotState:
        """Return the newest state; the same one until the next tick.

        Raises RobotFaultError when not connected or when the port has gone.
        """
        check_connected(self._opened is not None, WHO)
        if self._snapshot is None or self._snapshot[0] != self._clock.ticks:
            self._snapshot = (self._clock.ticks, self._newest())
        return self._snapshot[1].copy()

    def write(self, targets: JointTargets) -> JointTargets:
        """Send targets as pulses; return them, or the nearest that the pulse limits allow."""
        check_connected(self._opened is not None, WHO)
        check_targets(targets)
        sent = targets
        if self._map.outside(targets.positions_rad).any():
            self.counters.clipped += 1
            sent = JointTargets(self._map.limited_rad(targets.positions_rad), targets.stamp_s)
        pulses = self._map.to_us(sent.positions_rad)
        self._send(messages.override(pulses, self._peer.system, self._peer.component))
        self._assumed_rad = sent.positions_rad.copy()
        return sent

    def disable_torque(self) -> bool:
        """Let all servos go until the next targets."""
        check_connected(self._opened is not None, WHO)
        self._send(messages.release(self._peer.system, self._peer.component))
        return True

    def close(self) -> None:
        """Say goodbye and close the port; the board holds the pose."""
        if self._opened is not None:
            opened, self._opened = self._opened, None
            opened.close()

    def _send(self, message: object) -> None:
        self._check_port()
        try:
            self._link.send(message, self._peer.address)
        except OSError as error:
            raise RobotFaultError(self._gone(error)) from error

    def _check_port(self) -> None:
        if self._receiver.error is not None:
            raise RobotFaultError(self._gone(self._receiver.error))

    def _gone(self, error: OSError) -> str:
        return f"the port {self._port_text} has gone ({error.strerror or error}); is the cable still in?"

    def _await_peer(self) -> Peer:
        """Wait for the board's heartbeat."""

        def peer() -> Peer | None:
            self._check_port()
            return self._receiver.peer

        return wait_for(peer, PATIENCE_S, self._no_heartbeat, poll_s=0.002)

    def _no_heartbeat(self) -> str:
        """Return what to say and check when no servo board beats."""
        if self._receiver.wrong_type is not None:
            return (
                f"a MAVLink system of type {self._receiver.wrong_type} is at {self._port_text}, no servo "
                "board; allowed: MAV_TYPE 0 or 18, see docs/firmware.md"
            )
        heard = f"{self._link.received_bytes} bytes came, {self.counters.malformed} runs of them no MAVLink 2"
        return (
            f"no heartbeat of a servo board at {self._port_text} within {PATIENCE_S:g} s ({heard}); is it "
            "on, are port and baud rate right, and has it the same signing key or none?"
        )

    def _await_outputs(self) -> None:
        """Wait until the board says where its servos are, and lay this end's ticks between its states."""

        def first_outputs() -> Stamped | None:
            self._check_port()
            return self._receiver.newest("outputs")

        message = (
            f"the servo board at {self._port_text} sends no ACTUATOR_OUTPUT_STATUS with pulses in "
            "microseconds; see docs/firmware.md"
        )
        outputs = wait_for(first_outputs, PATIENCE_S, message, poll_s=0.002)
        if self._wall is not None:
            self._wall.begin(outputs.at_s - self._clock.period_s * PHASE)

    def _newest(self) -> RobotState:
        """Return the state that the newest messages hold."""
        self._check_port()
        now_s = time.monotonic()
        outputs = self._receiver.newest("outputs")
        assert outputs is not None  # noqa: S101  connect waited for it
        age_s = max(0.0, now_s - outputs.at_s)
        told = self._receiver.newest("measured")
        measured = told is not None and bool(told.value)
        position, quaternion = self._pose(outputs.at_s)
        battery = self._battery(now_s)
        fault = self._fault(now_s, battery)
        return RobotState(
            self._positions(outputs.value, measured=measured),
            stamp_s=max(0.0, self._clock.now_s - age_s),
            measured=measured,
            base_position_world=position,
            base_quaternion_world=quaternion,
            age_s=age_s,
            healthy=fault is None,
            fault=fault,
            battery_v=battery.voltage_v,
            battery_share=battery.share,
        )

    def _positions(self, outputs: messages.Outputs, *, measured: bool) -> FloatArray:
        """Return the joint angles that the board's outputs mean.

        Where a servo without feedback is that is not driven, nobody knows: it counts as where it was sent
        last, and before that as in the stance.
        """
        told = self._map.to_rad(outputs.pulses_us)
        unknown = np.isnan(told)
        if not measured:
            unknown |= ~outputs.active[self._map.channels - 1]
        return np.where(unknown, self._assumed_rad, told)

    def _pose(self, outputs_at_s: float) -> tuple[FloatArray | None, FloatArray | None]:
        """Return position and orientation; lost when outputs go on without them, not when all is silent.

        A board with an inertial sensor and nothing more knows its orientation alone.
        """
        if (odometry := _fresh(self._receiver.newest("odometry"), outputs_at_s, STALE_POSE_S)) is not None:
            return odometry.value.position_world, odometry.value.quaternion_world
        position = _fresh(self._receiver.newest("position"), outputs_at_s, STALE_POSE_S)
        attitude = _fresh(self._receiver.newest("attitude"), outputs_at_s, STALE_POSE_S)
        if attitude is None:
            return None, None
        return None if position is None else position.value, attitude.value

    def _battery(self, now_s: float) -> messages.Battery:
        """Return the newest reading of the battery; BATTERY_STATUS goes before SYS_STATUS."""
        for name in ("battery", "system"):
            reading = _fresh(self._receiver.newest(name), now_s, STALE_BATTERY_S)
            if reading is not None and reading.value.voltage_v is not None:
                battery: messages.Battery = reading.value
                return battery
        return messages.Battery(None, None)

    def _fault(self, now_s: float, battery: messages.Battery) -> str | None:
        """Return what is wrong with the board, or None."""
        least, voltage = self._map.low_battery_v, battery.voltage_v
        if least is not None and voltage is not None and voltage < least:
            return f"low battery {voltage:.1f} V"
        text = _fresh(self._receiver.newest("error"), now_s, ERROR_TEXT_S)
        if text is not None:
            return f"the board says: {text.value}"
        state = self._receiver.newest("heartbeat")
        if state is not None and state.value >= messages.EMERGENCY:
            return f"the board reports MAV_STATE {state.value}"
        return None


def _fresh(stamped: Stamped | None, now_s: float, within_s: float) -> Stamped | None:
    """Return what came if it is not too old."""
    return stamped if stamped is not None and now_s - stamped.at_s <= within_s else None
