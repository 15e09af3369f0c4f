"""The robot server: a single thread moves the robot, tick by tick and command by command."""

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from hexctl.backends.base import LegServos
from hexctl.backends.clock import Clock
from hexctl.control.guard import EXPIRY_S, Guard
from hexctl.errors import CommandRefusedError, EStopError, MessageError, RobotFaultError
from hexctl.robot.model import Robot
from hexctl.serve.commands import CommandHandler
from hexctl.serve.event_log import EventLog
from hexctl.serve.idle import SIT_AFTER_S, IdleSupervisor
from hexctl.serve.inbox import CAPACITY, Arrival, Inbox
from hexctl.serve.leases import LeaseManager, RequestHandler
from hexctl.serve.transport import Transport, attachment_of, payload_of
from hexctl.types import FloatArray, JointTargets, RobotState
from hexctl.wire.description import describe, encode_json
from hexctl.wire.links import Link
from hexctl.wire.messages import decode_pose, encode_battery, encode_pose, encode_positions, tag_of


class PosedServos(LegServos):
    """Servos whose state takes its pose from outside while that is fresh.

    A pose from outside wins over the robot's own; one that stops coming is gone, which the guard sees.
    """

    def __init__(self, servos: LegServos) -> None:
        self._servos = servos
        self.injects_failure, self.failure = servos.injects_failure, servos.failure
        self._pose: tuple[FloatArray, FloatArray] | None = None
        self._pose_at_s = 0.0

    @property
    def robot(self) -> Robot:
        """Return the robot of the servos."""
        return self._servos.robot

    @property
    def clock(self) -> Clock:
        """Return the clock of the servos."""
        return self._servos.clock

    @property
    def link_counts(self) -> dict[str, int]:
        """Return what became of the messages on the way to the servos."""
        return self._servos.link_counts

    def place(self, position_world: FloatArray, quaternion_world: FloatArray, at_s: float) -> None:
        """Take a pose over: position (3,) in m, (w, x, y, z), and when it came on time.monotonic."""
        self._pose, self._pose_at_s = (position_world, quaternion_world), at_s

    def connect(self) -> None:
        """Connect the servos."""
        self._servos.connect()

    def read(self) -> RobotState:
        """Return the state of the servos, with the pose from outside if there ever was one."""
        state = self._servos.read()
        if self._pose is None:
            return state
        fresh = time.monotonic() - self._pose_at_s <= EXPIRY_S
        position, quaternion = self._pose if fresh else (None, None)
        return replace(state, base_position_world=position, base_quaternion_world=quaternion)

    def write(self, targets: JointTargets) -> JointTargets:
        """Write to the servos."""
        return self._servos.write(targets)

    def rest(self) -> None:
        """Tell the servos that no command is due until the next one."""
        self._servos.rest()

    def relax(self) -> bool:
        """Let the servos go limp."""
        return self._servos.relax()

    def close(self) -> None:
        """Close the servos and forget the pose."""
        self._pose = None
        self._servos.close()


#: The next tick is left alone for this long before it is due, so that it is not late.
SPARE_S = 0.0003

#: Status goes out every so many ticks, the battery every so many.
STATUS_TICKS = 10
BATTERY_TICKS = 50


class RobotServer:
    """Serves connected-to-be servos on a link until told to stop.

    Between two ticks it obeys commands as they come, so that a command waits for nobody; at each tick it
    reads the servos, looks after silence and falls, and says how the robot is.
    """

    def __init__(
        self,
        servos: LegServos,
        link: Link,
        *,
        backend: str,
        simulated: Mapping[str, str] | None = None,
        sit_after_s: float = SIT_AFTER_S,
        say: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Take servos and a link.

        Args:
            servos: what is moved, not yet connected.
            link: where it is put.
            backend: the servos' name for people.
            simulated: of a simulation, what to tell of it: `world` and `failure`.
            sit_after_s: seconds without commands after which it sits down.
            say: told, in a line each, what a person beside the robot would ask.
        """
        self._servos = PosedServos(servos)
        self._guard = Guard(self._servos)
        self._backend, self._link = backend, link
        self._simulated = None if simulated is None else dict(simulated)
        self._leases = LeaseManager()
        self._commands = CommandHandler()
        self._requests = RequestHandler(self._guard, self._leases)
        self._idle = IdleSupervisor(self._guard, sit_after_s=sit_after_s)
        self._event_log = EventLog(say)
        self._inbox = Inbox()
        self._transport = Transport(link, servos.robot.name, self._inbox, self._requests.urgent)
        self._description = describe(servos.robot)
        self._state: RobotState | None = None
        self._sequence = self._ticks = 0
        self._good_until_s: float | None = None
        self._malformed_poses = 0

    def run(self, until: Callable[[], bool], *, ready: Callable[[], None] = lambda: None) -> None:
        """Serve until asked to stop; `ready` is called once clients may come.

        Raises InputError for a link that is not allowed, RobotFaultError when the servos or the address
        cannot be had, or the servos have gone.
        """
        try:
            with self._guard, self._transport:
                self._guard.clock.tick()
                ready()
                while not until():
                    self._listen()
                    self._tick()
        finally:
            self._event_log.close()

    def _listen(self) -> None:
        """Do what the network asks for until the next tick is due."""
        while (patience_s := self._guard.clock.due_in_s - SPARE_S) > 0:
            arrival = self._inbox.take(patience_s)
            if arrival is not None:
                self._handle(arrival)
        for _ in range(CAPACITY):  # for a clock that does not say when it is due
            arrival = self._inbox.take(0)
            if arrival is None:
                break
            self._handle(arrival)

    def _handle(self, arrival: Arrival) -> None:
        """Obey or answer one arrival; nothing that comes may end the robot's loop."""
        item = arrival.item
        if arrival.kind == "command":
            self._obey(payload_of(item), attachment_of(item), arrival.at_s)
        elif arrival.kind == "pose":
            self._place(payload_of(item), arrival.at_s)
        elif arrival.kind == "lease":
            self._transport.reply(arrival.kind, item, self._requests.lease(payload_of(item), arrival.at_s))
        elif arrival.kind == "estop":
            self._transport.reply(arrival.kind, item, self._requests.estop(payload_of(item), arrival.at_s))
        else:
            self._transport.reply(arrival.kind, item, {**self._description, "status": self.status()})

    def _obey(self, payload: bytes, attachment: bytes | None, at_s: float) -> None:
        now_s = time.monotonic()
        lease = self._leases.holder(now_s)
        try:
            checked = self._commands.check(payload, attachment, lease, at_s)
        except (MessageError, CommandRefusedError):
            return
        if now_s - at_s > checked.good_for_s:  # it waited here, while this thread was held up
            self._commands.counters.late += 1
            return
        servo_s = self._guard.clock.now_s
        stamp_s = servo_s - max(0.0, checked.delay_s + now_s - at_s)
        try:
            self._guard.write(JointTargets(checked.command.positions_rad, stamp_s))
        except (CommandRefusedError, EStopError, RobotFaultError):
            # Servos that have gone are noticed at the next tick.
            self._commands.counters.refused += 1
            return
        self._commands.counters.accepted += 1
        self._good_until_s = at_s + checked.good_for_s
        self._idle.commanded(servo_s)
        self._say(self._servos.read())

    def _place(self, payload: bytes, at_s: float) -> None:
        try:
            self._servos.place(*decode_pose(payload), at_s)
        except MessageError:
            self._malformed_poses += 1

    def _tick(self) -> None:
        """Let one control period pass: read, look after silence, say how the robot is."""
        self._guard.clock.tick()
        self._ticks += 1
        state = self._guard.read()
        self._look_after_silence()
        self._idle.tick(self._guard.clock.now_s)
        self._say(state)
        self._note()
        if self._ticks % STATUS_TICKS == 0:
            self._transport.publish("status", encode_json(self.status()))
        if self._ticks % BATTERY_TICKS == 0:
            self._transport.publish("battery", encode_battery(state.battery_v, state.battery_share))

    def _look_after_silence(self) -> None:
        """Freeze when commands ran out, and take the lease from whoever fell silent."""
        now_s = time.monotonic()
        resting = not self._guard.expects_commands
        if self._good_until_s is not None and not resting and now_s > self._good_until_s:
            self._guard.stop("expired")
        if resting:
            self._good_until_s = None
        if self._guard.stopped == "expired":
            self._leases.revoke()

    def _note(self) -> None:
        """Tell whoever stands beside the robot what has changed."""
        lease = self._leases.holder(time.monotonic())
        self._event_log.note(
            controller=None if lease is None else lease.owner,
            stopped=self._guard.stopped,
            posture=self._idle.name,
        )

    def _say(self, state: RobotState) -> None:
        """Publish a state."""
        self._state = state
        self._sequence += 1
        tag = tag_of(
            replace(state, stopped=self._guard.stopped),
            sequence=self._sequence,
            stamp_ns=time.monotonic_ns(),
            command_sequence=self._commands.newest_sequence,
        ).packed()
        if state.base_position_world is not None and state.base_quaternion_world is not None:
            pose = encode_pose(state.base_position_world, state.base_quaternion_world)
            self._transport.publish("odom", pose, tag)
        self._transport.publish("joint_states", encode_positions(state.joint_positions_rad), tag)

    def status(self) -> dict[str, Any]:
        """Return what the robot says of itself, as JSON values."""
        now_s = time.monotonic()
        lease, state, guard = self._leases.holder(now_s), self._state, self._guard
        self._commands.counters.overflowed = self._inbox.overflowed
        return {
            "robot": guard.robot.name,
            "backend": self._backend,
            "simulated": self._simulated,
            "stopped": guard.stopped,
            "posture": self._idle.name,
            "controller": None if lease is None else lease.owner,
            "controller_since_s": None if lease is None else round(now_s - lease.since_s, 1),
            "leases_refused": self._leases.refused,
            "commands": self._commands.counters.as_json(),
            "clipped": guard.counters.clipped,
            "servo_link": guard.link_counts or None,
            "malformed": {"requests": self._requests.malformed, "poses": self._malformed_poses},
            "ticks": self._ticks,
            "overruns": guard.clock.overruns,
            "joints": None if state is None else ("measured" if state.measured else "echoed"),
            "pose": state is not None and state.base_position_world is not None,
            "state_age_s": None if state is None else _number(state.age_s),
            "fault": None if state is None else state.fault,
            "battery_v": None if state is None else _number(state.battery_v),
            "battery_share": None if state is None else _number(state.battery_share),
            "endpoint": self._link.endpoint,
            "secured": self._link.credentials is not None,
            "insecure": self._link.insecure,
        }


def _number(value: float | None) -> float | None:
    """Return a reading as JSON takes it: what is no number is unknown."""
    return None if value is None or not math.isfinite(value) else round(value, 3)
