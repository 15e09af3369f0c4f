"""The ROS 2 node of a served robot, on its own thread: network trouble does not delay the robot."""

import threading
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Self

import zenoh

from hexctl.errors import MessageError
from hexctl.robot.formats.urdf import urdf_of
from hexctl.robot.model import Robot
from hexctl.server.ros.settings import LiveSettings, ParameterServices, RosSettings
from hexctl.server.ros.topics import RobotMessages, RobotTopics
from hexctl.server.snapshot import RobotSnapshot
from hexctl.server.transport import Inbox
from hexctl.time_source import WALL_TIME, TimeSource
from hexctl.wire import ros_cdr
from hexctl.wire.links import Endpoint
from hexctl.wire.ros.motion_commands import (
    OFF,
    POSE,
    TWIST,
    TWIST_STAMPED,
    Called,
    RosCommand,
    Service,
    WantedJoints,
    WantedVelocity,
    decode_body_pose,
    decode_velocity,
)
from hexctl.wire.ros.ros_names import Kind, RosEndpoint, RosNode
from hexctl.wire.ros.ros_session import (
    RosRequest,
    RosService,
    RosSubscription,
    RouterWatch,
    check_router,
    open_ros_session,
)
from hexctl.wire.ros.telemetry import encode_trigger_answer
from hexctl.wire.transit_delay import StampCheck
from hexctl.wire.zenoh_messages import decode_positions

#: Pause before a failed session is opened again.
REOPEN_S = 1.0

#: Maximum time between two looks for requests.
LONGEST_WAIT_S = 0.05

#: A robot without a new state for this long is silent.
SILENT_S = 1.0

#: Topics that move the robot, only with `drive`; a topic has one subscription per type.
VELOCITIES = (TWIST, TWIST_STAMPED)

#: Types of commands that begin with a header.
STAMPED = (TWIST_STAMPED, ros_cdr.JOINT_STATE)
JOINTS_TOPIC = "robot_joint_command"
POSE_TOPIC = "body_pose"
STOP_TOPIC = "~/estop"
STOP_MESSAGE = "std_msgs/msg/Empty"
TRIGGER = "std_srvs/srv/Trigger"

_FIRST_SUBSCRIPTION, _FIRST_SERVICE = 30, 40


@dataclass(slots=True)
class RosCounters:
    """Counts of messages from ROS.

    `malformed` includes requests without a client's attachment; `late` are commands with an old stamp.
    """

    commands: int = 0
    stops: int = 0
    malformed: int = 0
    late: int = 0
    sessions: int = 0


class RosBridge:
    """The node `hexctl` of a robot, on its own thread.

    Args:
        inbox: takes the commands.
        stop: stops the robot; called on the bridge's thread.
        router: address of the ROS router, `tcp/HOST:PORT`.
        settings: initial parameters; whether ROS may move the robot is one of them.
        insecure: whether the router may be on another computer.

    Raises InputError if the router is not allowed.
    """

    def __init__(
        self,
        robot: Robot,
        node: RosNode,
        inbox: Inbox,
        stop: Callable[[], None],
        *,
        router: str,
        settings: RosSettings,
        insecure: bool = False,
        time: TimeSource = WALL_TIME,
    ) -> None:
        self._time = time
        self.node, self.drive = node, settings.ros_drive
        self.live = LiveSettings(robot, settings)
        self.counters, self._stamps = RosCounters(), StampCheck()
        self._router: Endpoint = check_router(router, insecure=insecure)
        self._watch = RouterWatch(self._router)
        described = urdf_of(
            robot,
            ros2_control=self.drive,
            command_topic=node.resolved(JOINTS_TOPIC),
            state_topic=node.resolved("joint_states"),
        )
        self._messages = RobotMessages(robot, described, node.full_name)
        self._states = Inbox()
        self._inbox, self._stop = inbox, stop
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="ros", daemon=True)
        self._connected = False
        self._trouble: str | None = None

    def __enter__(self) -> Self:
        """Start to look for the router, and publish once it is found."""
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._closing.set()
        self._thread.join(timeout=2.0)  # a session that cannot be closed must not keep the robot

    def offer(self, snapshot: RobotSnapshot) -> None:
        """Hand over a state; never waits."""
        self._states.put("state", snapshot)

    def status(self) -> dict[str, Any]:
        """State of the ROS connection, as JSON values."""
        return {
            "router": str(self._router),
            "connected": self._connected,
            "drive": self.drive,
            "trouble": self._trouble,
            **asdict(self.counters),
        }

    def _run(self) -> None:
        while not self._closing.is_set():
            try:
                with open_ros_session(self._router) as session:
                    self.counters.sessions += 1
                    self._serve(session)
            except Exception as error:  # noqa: BLE001  the robot works on, and ROS is tried again
                self._connected, self._trouble = False, f"{type(error).__name__}: {error}"
                self._time.wait(self._closing, REOPEN_S)

    def _serve(self, session: zenoh.Session) -> None:
        token = session.liveliness().declare_token(self.node.token(str(session.info.zid())))
        topics = RobotTopics(session, self.node, self._messages)
        commands = _Commands(session, self.node, self)
        parameters = ParameterServices(session, self.node, self.live)
        heard_at_s = looked_at_s = self._time.now()
        while not self._closing.is_set():
            arrival = self._states.take(LONGEST_WAIT_S)
            now_s = self._time.now()
            commands.take()
            self.counters.malformed += parameters.answer()
            if arrival is not None:
                heard_at_s = now_s
                topics.publish(arrival.item, now_s)
            elif now_s - heard_at_s > SILENT_S:
                topics.publish_silence(now_s)
            if now_s - looked_at_s > REOPEN_S:
                looked_at_s = now_s
                self._look(session, now_s)
        token.undeclare()  # type: ignore[no-untyped-call]

    def _look(self, session: zenoh.Session, now_s: float) -> None:
        self._connected = bool(session.info.routers_zid())
        self._trouble = self._watch.trouble(self._connected, now_s)

    @property
    def condition(self) -> str | None:
        """One line on the router: found, or why not; None while unknown."""
        return f"ROS router at {self._router} found" if self._connected else self._trouble

    def is_in_time(self, stamp_s: float | None, sender: bytes) -> bool:
        """Whether a command with a stamp, or None, that arrives now is not late; late ones are counted."""
        in_time = self._stamps.admits(stamp_s, self._time.now(), sender)
        self.counters.late = self._stamps.late
        return in_time

    def put(self, command: RosCommand) -> None:
        """Hand a command to the robot's thread."""
        self._inbox.put("ros", command)

    def stop(self) -> None:
        """Stop the robot immediately; the robot's next tick ends every motion."""
        self.counters.stops += 1
        self._stop()


class _Commands:
    def __init__(self, session: zenoh.Session, node: RosNode, bridge: RosBridge) -> None:
        self._bridge, self._counters = bridge, bridge.counters
        wanted = [(STOP_TOPIC, STOP_MESSAGE)]
        if bridge.drive:
            wanted += [("cmd_vel", kind) for kind in VELOCITIES]
            wanted += [(JOINTS_TOPIC, ros_cdr.JOINT_STATE), (POSE_TOPIC, POSE)]
        self._subscriptions = {
            (topic, kind): RosSubscription(
                session, RosEndpoint(node, Kind.SUBSCRIPTION, topic, kind, _FIRST_SUBSCRIPTION + number)
            )
            for number, (topic, kind) in enumerate(wanted)
        }
        self._services = {
            service: RosService(
                session,
                RosEndpoint(node, Kind.SERVICE, f"~/{service.value}", TRIGGER, _FIRST_SERVICE + number),
            )
            for number, service in enumerate(Service)
        }

    def take(self) -> None:
        """Pass on what has arrived since the last call; of each topic only the newest."""
        for (topic, kind), subscription in self._subscriptions.items():
            message = subscription.newest()
            if message is None:
                continue
            if topic == STOP_TOPIC:  # with any content: a stop is never refused
                self._bridge.stop()
            else:
                self._pass(topic, kind, *message)
        for service, server in self._services.items():
            request = server.next_request()
            if request is not None:
                self._call(service, partial(_answer, request))
        self._counters.malformed += sum(server.take_malformed() for server in self._services.values())

    def _pass(self, topic: str, kind: str, payload: bytes, sender: bytes) -> None:
        try:
            if topic == JOINTS_TOPIC:
                command: RosCommand = WantedJoints(decode_positions(payload))
            elif topic == POSE_TOPIC:
                command = decode_body_pose(payload)
            else:
                command = WantedVelocity(decode_velocity(kind, payload))
        except MessageError:
            self._counters.malformed += 1
            return
        stamp_s = ros_cdr.stamp_s(payload) if kind in STAMPED else None
        stops = isinstance(command, WantedVelocity) and not command.velocity.any()
        if not self._bridge.is_in_time(stamp_s, sender) and not stops:
            return
        self._counters.commands += 1
        self._bridge.put(command)

    def _call(self, service: Service, answer: Callable[[bool, str], None]) -> None:
        if self._bridge.drive:
            self._bridge.put(Called(service, answer))
        else:
            answer(False, OFF)


def _answer(request: RosRequest, success: bool, message: str) -> None:
    request.answer(encode_trigger_answer(success, message))
