"""Hobby servos on a board that speaks MAVLink 2, as LegServos. The board's side is docs/firmware.md."""

import time
from contextlib import ExitStack
from dataclasses import replace

import numpy as np

from hexctl.backends.base import LegServos
from hexctl.backends.checks import check_connected, check_targets
from hexctl.backends.clock import Clock, WallClock
from hexctl.backends.mavlink import messages
from hexctl.backends.mavlink.address import parse_port
from hexctl.backends.mavlink.codec import Codec
from hexctl.backends.mavlink.link import MavlinkLink
from hexctl.backends.mavlink.port import open_port
from hexctl.backends.mavlink.receiver import LinkCounters, Peer, Receiver, Stamped
from hexctl.backends.mavlink.ticking import CountedClock
from hexctl.errors import RobotFaultError
from hexctl.robot.model import Robot
from hexctl.robot.servo_map import ServoMap
from hexctl.types import FloatArray, JointTargets, RobotState

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
        return _copy(self._snapshot[1])

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

    def relax(self) -> bool:
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
        until_s = time.monotonic() + PATIENCE_S
        while self._receiver.peer is None:
            self._check_port()
            if time.monotonic() > until_s:
                raise RobotFaultError(self._no_heartbeat())
            time.sleep(0.002)
        return self._receiver.peer

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
        until_s = time.monotonic() + PATIENCE_S
        while (outputs := self._receiver.newest("outputs")) is None:
            self._check_port()
            if time.monotonic() > until_s:
                raise RobotFaultError(
                    f"the servo board at {self._port_text} sends no ACTUATOR_OUTPUT_STATUS with pulses in "
                    "microseconds; see docs/firmware.md"
                )
            time.sleep(0.002)
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


def _copy(state: RobotState) -> RobotState:
    """Return a state whose arrays the caller may change."""
    position, quaternion = state.base_position_world, state.base_quaternion_world
    return replace(
        state,
        joint_positions_rad=state.joint_positions_rad.copy(),
        base_position_world=None if position is None else position.copy(),
        base_quaternion_world=None if quaternion is None else quaternion.copy(),
    )
