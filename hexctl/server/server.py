"""The robot server: a single thread moves the robot."""

import math
import time as wall
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

from hexctl.backends.base import LegServos, failures_in_force
from hexctl.backends.clock import SPARE_S, STANDSTILL_S, Standstill
from hexctl.control.guard import EXPIRY_S, Guard
from hexctl.errors import CommandRefusedError, EStopError, MessageError, RobotFaultError
from hexctl.server.event_log import EventLog
from hexctl.server.idle import SIT_AFTER_S, IdleSupervisor, RestWatch
from hexctl.server.leases import CommandHandler, LeaseManager
from hexctl.server.requests import RequestHandler
from hexctl.server.served_servos import ServedServos
from hexctl.server.snapshot import RobotSnapshot
from hexctl.server.stops.latch import StopLatch
from hexctl.server.stops.stop_file import StopFile
from hexctl.server.stops.stop_socket import StopSocket
from hexctl.server.transport import MOST_WAITING, Arrival, Inbox, Transport, attachment_of, payload_of
from hexctl.types import FloatArray, JointTargets, RobotState
from hexctl.wire.description import RobotIdentity, describe, encode_json
from hexctl.wire.links import CLEAR_COMMAND, Link
from hexctl.wire.pose import decode_estimate, encode_pose
from hexctl.wire.ros import telemetry
from hexctl.wire.ros_cdr import stamp_s
from hexctl.wire.stop import ESTOP
from hexctl.wire.transit_delay import RENEWED_S, StampCheck
from hexctl.wire.zenoh_messages import SERVER_ENDED, encode_battery, encode_positions, tag_of

if TYPE_CHECKING:
    from hexctl.server.keeper import Keeper
    from hexctl.server.ros.bridge import RosBridge
    from hexctl.server.ros.driver import RosDriver
    from hexctl.server.ros.settings import LiveSettings

#: Period of the status and of the battery, in ticks.
STATUS_TICKS = 10
BATTERY_TICKS = 50

#: Posture in the status while the servos cannot be reached.
UNREACHED = "unreached"


class RobotServer:
    """Serves one robot's servos on a link.

    Commands are executed between ticks. A tick reads the servos, checks expiry and falls, and publishes.
    """

    def __init__(
        self,
        servos: LegServos,
        link: Link,
        *,
        backend: str,
        simulated: Mapping[str, str] | None = None,
        sit_after_s: float = SIT_AFTER_S,
        on_event: Callable[[str], None] = lambda _: None,
        keeper: "Keeper | None" = None,
        ros: "Callable[[Inbox, Callable[[], None]], RosBridge] | None" = None,
        stop_file: StopFile | None = None,
        clear: str = CLEAR_COMMAND,
    ) -> None:
        """Prepare to serve without opening anything; a stop in the stop file is in force.

        Args:
            backend: name of the servos' backend, for the status.
            simulated: `world` and `failure` of a simulation, for the status; None for a real robot.
            on_event: takes a line for each change of controller, stop and posture, on the event log's thread.
            keeper: told in every control period that this server lives.
            ros: makes the ROS 2 node; called with the inbox of commands and a function that stops the robot.
            clear: command that ends a stop, for the events.
        """
        self._servos = ServedServos(servos)
        self._guard = Guard(
            self._servos, tilt_of=self._servos.tilt_of, trusts_position=self._servos.has_simulated_pose
        )
        self._time = self._guard.clock.time
        self._link = link
        self._simulated = None if simulated is None else dict(simulated)
        self._leases = LeaseManager()
        self._commands = CommandHandler()
        self._latch = StopLatch(self._guard, stop_file, lambda: self._leases.last_owner)
        self._rest = RestWatch()
        self._stop_socket = StopSocket(
            link, servos.robot.name, self._latch, lambda: self._rest.at_rest, self._echoes
        )
        self._requests = RequestHandler(self._guard, self._leases, self._latch)
        self._keeper = keeper
        self._idle = IdleSupervisor(self._guard, sit_after_s=sit_after_s)
        self._event_log = EventLog(on_event, clear=clear, time=self._time)
        self._inbox = Inbox(time=self._time)
        self._transport = Transport(
            link, servos.robot.name, self._inbox, self._requests.urgent, self._admits_command
        )
        self._description = describe(servos.robot)
        self._who = asdict(RobotIdentity.of_this_process(servos.robot.name, backend))
        self._state: RobotState | None = None
        self._sequence = self._ticks = 0
        self._good_until_s: float | None = None
        self._standstill: Standstill | None = None
        self._ticked_s = math.inf
        self._malformed_poses = 0
        self._pose_stamps = StampCheck(RENEWED_S, RENEWED_S)
        self._ros = None if ros is None else ros(self._inbox, self._requests.stop_over_ros)
        self._driver: RosDriver | None = None
        if self._ros is not None and self._ros.drive:
            self._driver = self._made_driver(self._ros.live)

    def run(self, until: Callable[[], bool], *, ready: Callable[[], None] = lambda: None) -> None:
        """Serve until `until` returns True; `ready` is called once clients can connect.

        Raises InputError for an invalid link, RobotFaultError when the servos cannot be reached or
        fail, or when the address cannot be used.
        """
        try:
            with self._guard, self._transport, self._stop_socket, self._ros or nullcontext():
                self._guard.clock.tick()
                ready()
                self._ticked_s = self._time.now()
                try:
                    while not until():
                        self._listen()
                        self._tick()
                finally:
                    self._note_end()
        finally:
            self._event_log.close()
            self._latch.close()

    def _note_end(self) -> None:
        if self._state is not None:
            self._publish(replace(self._state, healthy=False, fault=SERVER_ENDED))
        lease = self._leases.current(self._time.now())
        if lease is not None:
            left = "its servos are left with their last targets"
            rest = left if self._simulated is None else "the simulation ends with it"
            self._event_log.add(f"ended while {lease.owner} commanded it; {rest}")

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for the operator once clients can connect."""
        trouble = self._stop_socket.trouble
        return () if trouble is None else (f"it can only be stopped over a session: {trouble}",)

    @property
    def _posture(self) -> str:
        return self._idle.name if self.reaches_servos else UNREACHED

    @property
    def reaches_servos(self) -> bool:
        """Whether the newest state comes from reachable servos."""
        return self._state is None or _is_reached(self._state)

    def _echoes(self) -> bool:
        state = self._state
        return state is not None and not state.measured

    def _listen(self) -> None:
        while (timeout_s := self._guard.clock.due_in_s - SPARE_S) > 0:
            arrival = self._inbox.take(timeout_s)
            if arrival is not None:
                self._handle(arrival)
        most = sum(MOST_WAITING.values())
        for _ in range(most):  # for a clock that does not know when its next tick is due
            arrival = self._inbox.take(0)
            if arrival is None:
                break
            self._handle(arrival)

    def _handle(self, arrival: Arrival) -> None:
        """No content of a message may end the loop."""
        self._note_standstill()  # before its consequences
        item = arrival.item
        if arrival.kind == "command":
            self._execute(payload_of(item), attachment_of(item), arrival.at_s)
        elif arrival.kind == "ros" and self._driver is not None:
            self._driver.obey(item, arrival.at_s)
        elif arrival.kind == "pose":
            self._set_pose(payload_of(item), arrival.at_s)
        elif arrival.kind == "lease":
            answer = self._requests.lease(payload_of(item), arrival.at_s)
            if "lease" in answer:  # earlier states may arrive after the answer
                answer["state"] = self._sequence
                self._idle.controlled(self._guard.clock.now_s)
            self._transport.reply(arrival.kind, item, answer)
        elif arrival.kind == "failure":
            answer = self._requests.failure(payload_of(item), arrival.at_s)
            if "failures" in answer and self._simulated is not None:
                self._simulated["failure"] = ", ".join(answer["failures"]) or "none"
                self._event_log.add(f"legs set to fail: {', '.join(answer['failures']) or 'all are whole'}")
            self._transport.reply(arrival.kind, item, {**answer, **self._who})
            if "failures" in answer:
                self._publish_status()
        elif arrival.kind == "estop":
            answer = self._requests.estop(payload_of(item), arrival.at_s)
            self._transport.reply(arrival.kind, item, {**answer, **self._who})
        else:
            self._transport.reply(arrival.kind, item, {**self._description, "status": self.status()})

    def _admits_command(self, attachment: bytes | None) -> bool:
        return self._commands.admits(attachment, self._leases.current(self._time.now()))

    def _execute(self, payload: bytes, attachment: bytes | None, at_s: float) -> None:
        now_s = self._time.now()
        lease = self._leases.current(now_s)
        checked = self._commands.check(payload, attachment, lease, at_s)
        if checked is None:
            return
        if now_s - at_s > checked.good_for_s:  # it waited in the inbox while this thread was busy
            self._commands.counters.late += 1
            return
        late_s = max(0.0, checked.delay_s + now_s - at_s)
        try:
            self._write(checked.joint_positions_rad, late_s, at_s + checked.good_for_s)
        except (CommandRefusedError, EStopError, RobotFaultError):
            # Failed servos are detected at the next read.
            self._commands.counters.refused += 1
            return
        if checked.sequence <= self._requests.rested_after:
            # The request to rest overtook this command, on another thread: expect no further one.
            self._guard.pause_watchdog()
        self._commands.counters.accepted += 1
        self._leases.heard(at_s)
        self._publish(self._guard.peek())

    def _write(self, joint_positions_rad: FloatArray, late_s: float, good_until_s: float) -> None:
        """Write targets that arrived `late_s` late and expire at `good_until_s`."""
        servo_s = self._guard.clock.now_s
        self._guard.write(JointTargets(joint_positions_rad, servo_s - late_s))
        self._good_until_s = good_until_s
        self._idle.commanded(servo_s)

    def _made_driver(self, live: "LiveSettings") -> "RosDriver":
        from hexctl.server.ros.driver import RosDriver

        def write(joint_positions_rad: FloatArray, at_s: float) -> None:
            self._write(joint_positions_rad, max(0.0, self._time.now() - at_s), at_s + EXPIRY_S)

        return RosDriver(self._guard, self._requests, self._idle, write, live)

    def _set_pose(self, payload: bytes, at_s: float) -> None:
        try:
            position, quaternion, covariance = decode_estimate(payload)
        except MessageError:
            self._malformed_poses += 1
            return
        if not self._pose_stamps.admits(stamp_s(payload), at_s):
            return
        if self._servos.posed_at_s is None:
            if position is None and quaternion is None:
                return  # no state yet
            self._guard.forget_pose()
        self._servos.set_pose(position, quaternion, covariance, at_s)

    def _tick(self) -> None:
        index = self._guard.clock.tick().index
        self._note_standstill()
        self._ticked_s = self._time.now()
        self._ticks += 1
        kept = None if self._keeper is None else self._keeper.tick(stopped=self._idle.holds_after_stop)
        if (event := kept or self._stop_socket.take_event()) is not None:
            self._event_log.add(event)
        state = self._guard.read()
        self._check_expiry()
        if (stop := self._latch.current()) is not None and stop.reason == ESTOP:
            self._leases.revoke()  # a stop by datagram bypasses the requests
        self._rest.note(state.joint_positions_rad, self._time.now(), reached=_is_reached(state))
        if self._driver is not None:
            self._driver.tick(index, state)
        self._idle.tick(self._guard.clock.now_s)
        self._publish_served_poses()
        self._publish(state)
        snapshot = self._snapshot(state)
        if self._ros is not None:
            self._ros.offer(snapshot)
        self._event_log.note(snapshot)
        if self._ticks % STATUS_TICKS == 0:
            self._publish_status()
        if self._ticks % BATTERY_TICKS == 0:
            self._transport.publish("battery", encode_battery(state.battery_v, state.battery_share))

    def _note_standstill(self) -> None:
        now_s, known = self._time.now(), self._standstill
        passed_s = now_s - self._ticked_s
        if passed_s > STANDSTILL_S and (known is None or known.ended_s < self._ticked_s):
            self._standstill = Standstill(passed_s, now_s)

    def _check_expiry(self) -> None:
        now_s = self._time.now()
        resting = not self._guard.expects_commands
        if self._good_until_s is not None and not resting and now_s > self._good_until_s:
            self._guard.stop("expired")
        if resting:
            self._good_until_s = None
        if self._guard.stopped == "expired":
            self._leases.revoke()

    @property
    def _controller(self) -> str | None:
        lease = self._leases.current(self._time.now())
        return None if lease is None else lease.owner

    def _publish(self, state: RobotState) -> None:
        self._state = state
        self._sequence += 1
        tag = tag_of(
            replace(state, stopped=self._guard.stopped),
            sequence=self._sequence,
            stamp_ns=round(1e9 * self._time.now()),
            command_sequence=self._commands.newest_sequence,
        ).packed()
        if state.base_position_world is not None or state.base_quaternion_world is not None:
            pose = encode_pose(
                state.base_position_world,
                state.base_quaternion_world,
                covariance=self._servos.pose_covariance,
            )
            self._transport.publish("odom", pose, tag)
        joints = encode_positions(
            state.joint_positions_rad,
            torques_nm=state.joint_torques_nm,
            velocities_rad_s=state.joint_velocities_rad_s,
        )
        self._transport.publish("joint_states", joints, tag)

    def _publish_served_poses(self) -> None:
        stamp_ns, simulation = wall.time_ns(), self._servos.simulation
        if (orientation := self._servos.own_orientation) is not None:
            self._transport.publish("imu", telemetry.encode_imu(stamp_ns, orientation))
        if simulation is not None and (truth := simulation.true_pose) is not None:
            self._transport.publish("truth", encode_pose(*truth, stamp_ns=stamp_ns))

    def _snapshot(self, state: RobotState) -> RobotSnapshot:
        return RobotSnapshot(
            state=state,
            orientation=self._servos.own_orientation,
            posed_at_s=self._servos.posed_at_s,
            posture=self._posture,
            controller=self._controller,
            stop=self._latch.current(),
            cleared=self._latch.cleared,
            ros=None if self._ros is None else self._ros.condition,
            doubt=self._guard.positions.doubt(self._guard.clock.now_s),
            standstill=self._standstill,
        )

    def _publish_status(self) -> None:
        self._transport.publish("status", encode_json(self.status()))

    def status(self) -> dict[str, Any]:
        """Status of the robot, as JSON values."""
        now_s = self._time.now()
        lease, state, guard = self._leases.current(now_s), self._state, self._guard
        self._commands.counters.overflowed = self._inbox.overflowed
        cleared, failures = self._latch.cleared, failures_in_force(guard)
        driving = {} if self._driver is None else self._driver.status()
        return {
            **self._who,
            "simulated": self._simulated,
            "failures": None if failures is None else [one.typed for one in failures],
            "stopped": guard.stopped,
            "stop": self._latch.status(),
            "cleared": None if cleared is None else cleared.to_json(now_s),
            "at_rest": self._rest.at_rest,
            "posture": self._posture,
            "controller": None if lease is None else lease.owner,
            "controller_since_s": None if lease is None else round(now_s - lease.since_s, 1),
            "leases_refused": self._leases.refused,
            "commands": asdict(self._commands.counters),
            "clipped": guard.counters.clipped,
            "servo_link": guard.link_counts or None,
            "malformed": {"requests": self._requests.malformed, "poses": self._malformed_poses},
            "late_poses": self._pose_stamps.late,
            "positions_doubted": guard.positions.doubted,
            "ticks": self._ticks,
            "overruns": guard.clock.overruns,
            "joints": None if state is None else ("measured" if state.measured else "echoed"),
            "pose": state is not None and state.base_position_world is not None,
            "state_age_s": None if state is None else _number(state.age_s),
            "fault": None if state is None else state.fault,
            "warnings": [] if state is None else list(state.warnings),
            "servos": None if state is None or state.servos is None else state.servos.to_json(),
            "battery_v": None if state is None else _number(state.battery_v),
            "battery_share": None if state is None else _number(state.battery_share),
            "ros": None if self._ros is None else {**self._ros.status(), **driving},
            "stop_port": self._stop_socket.port,
            "endpoint": self._link.endpoint,
            "secured": self._link.credentials is not None,
            "insecure": self._link.insecure,
        }


def _is_reached(state: RobotState) -> bool:
    return state.age_s <= EXPIRY_S


def _number(value: float | None) -> float | None:
    """None for non-finite values, which JSON lacks."""
    return None if value is None or not math.isfinite(value) else round(value, 3)
