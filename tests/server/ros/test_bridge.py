"""A served robot in ROS 2, seen by a peer of another project through a router: no ROS here."""

import io
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xxhash
import yourdfpy
import zenoh
import zenoh.ext
from zenoh_ros2_sdk import discovery
from zenoh_ros2_sdk.publisher import ROS2Publisher
from zenoh_ros2_sdk.session import ZenohSession
from zenoh_ros2_sdk.subscriber import ROS2Subscriber

from hexctl.server.ros.settings import parameter_endpoint
from hexctl.types import JOINT_NAMES
from hexctl.wire import ros_cdr
from hexctl.wire.ros import telemetry
from hexctl.wire.ros.motion_commands import POSE, TWIST, TWIST_STAMPED
from hexctl.wire.ros.parameters import ParameterService
from hexctl.wire.ros.ros_names import Kind, RosEndpoint, RosNode, type_hash
from hexctl.wire.ros.ros_session import SIZE, Attachment
from hexctl.wire.zenoh_session import open_configured
from tests.server.processes import Served, free_port, served, wait_until
from tests.server.ros.test_settings import decoded_answer, named, request, wishes
from tests.wire.ros.decoding import decoded, definition

pytestmark = pytest.mark.realtime

EMPTY, VECTOR = "std_msgs/msg/Empty", "geometry_msgs/msg/Vector3"

#: What `ros2 topic list -t` shows of a robot that ROS may drive.
TOPICS = {
    "/joint_states": ["sensor_msgs/msg/JointState"],
    "/odom": ["nav_msgs/msg/Odometry"],
    "/tf": ["tf2_msgs/msg/TFMessage"],
    "/tf_static": ["tf2_msgs/msg/TFMessage"],
    "/imu/data": ["sensor_msgs/msg/Imu"],
    "/battery_state": ["sensor_msgs/msg/BatteryState"],
    "/diagnostics": ["diagnostic_msgs/msg/DiagnosticArray"],
    "/robot_description": ["std_msgs/msg/String"],
    "/foot_contacts": ["std_msgs/msg/UInt8MultiArray"],
    "/hexctl/estop": ["std_msgs/msg/Empty"],
    "/cmd_vel": [TWIST, TWIST_STAMPED],
    "/robot_joint_command": [ros_cdr.JOINT_STATE],
    "/body_pose": [POSE],
}


@contextmanager
def router(port: int) -> Iterator[zenoh.Session]:
    """A router as rmw_zenohd is one, on loopback."""
    settings = {
        "mode": "router",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": True,
        "listen/endpoints": [f"tcp/127.0.0.1:{port}"],
    }
    with open_configured(settings) as session:
        yield session


class Peer:
    """A ROS 2 node of zenoh-ros2-sdk, at a router.

    It loads definitions from the network unless it is given them; here they come from rosbags.
    """

    def __init__(self, port: int) -> None:
        self._port = port
        self._open: list[Any] = []
        self._shared = ZenohSession.get_instance("127.0.0.1", port)
        self.session: zenoh.Session = self._shared.session

    def close(self) -> None:
        """End all publishers and subscriptions, and the session."""
        for each in self._open:
            each.close()
        self._shared.close()

    def topics(self) -> dict[str, list[str]]:
        """Topics with their types, as `ros2 topic list -t` shows them."""
        found = discovery.get_topic_names_and_types(0, router_port=self._port, timeout=1.0)
        return {name: list(types) for name, types in found}

    def tokens(self, pattern: str) -> list[str]:
        """Liveliness tokens that a pattern matches; for a moment after it has connected, a peer sees none."""

        def asked() -> list[str]:
            replies = self.session.liveliness().get(pattern, timeout=1.0)
            return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]

        found: list[str] = wait_until(asked, pattern)
        return found

    def info(self, topic: str) -> discovery.TopicInfo:
        """Endpoints of a topic, as `ros2 topic info -v` shows them, once there are any."""

        def asked() -> discovery.TopicInfo | None:
            return discovery.get_topic_info(topic, 0, router_port=self._port, timeout=1.0, verbose=True)

        found: discovery.TopicInfo = wait_until(asked, topic)
        return found

    def make(self, kind: str, **fields: Any) -> Any:
        """A message of a type that one of its publishers needed."""
        return self._shared.store.types[kind](**fields)

    def subscribed(self, topic: str, kind: str) -> list[Any]:
        """List that fills with the messages of a topic."""
        got: list[Any] = []
        self._open.append(ROS2Subscriber(topic, kind, got.append, **self._described(kind)))
        return got

    def publisher(self, topic: str, kind: str) -> Any:
        self._open.append(ROS2Publisher(topic, kind, **self._described(kind)))
        return self._open[-1]

    def _described(self, kind: str) -> dict[str, Any]:
        return {
            "msg_definition": definition(kind),
            "type_hash": type_hash(kind),
            "router_port": self._port,
        }


@contextmanager
def peer(port: int) -> Iterator[Peer]:
    """A peer that sees the robot's node; the SDK has one session per process."""
    opened = Peer(port)
    try:
        wait_until(lambda: "/joint_states" in opened.topics(), "the robot's topics")
        yield opened
    finally:
        opened.close()


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Served, Peer]]:
    """A robot in the simulation that was there before its router and that ROS may drive, and a peer."""
    port = free_port()
    folder = tmp_path_factory.mktemp("ros")
    options = ("--ros", f"tcp/127.0.0.1:{port}", "--ros-drive")
    with served(folder, *options, backend="sim") as robot, router(port), peer(port) as node:
        yield robot, node


def data_key(topic: str, kind: str) -> str:
    return RosEndpoint(RosNode(), Kind.PUBLISHER, topic, kind, 0).key


def hear_joints(session: zenoh.Session) -> list[Any]:
    """Some samples of joint states, one after another."""
    got: list[Any] = []
    found = session.declare_subscriber(data_key("joint_states", ros_cdr.JOINT_STATE), got.append)
    wait_until(lambda: len(got) > 10, "joint states")
    found.undeclare()  # type: ignore[no-untyped-call]
    return got


def test_the_node_and_its_topics_are_listed_with_who_and_how(network: tuple[Served, Peer]) -> None:
    _, node = network
    wait_until(lambda: {name: sorted(kinds) for name, kinds in node.topics().items()} == TOPICS, "the list")
    assert len(node.tokens("@ros2_lv/0/*/0/0/NN/%/%/hexctl")) == 1
    info = node.info("/tf_static")
    (publisher,) = info.publishers
    assert (publisher.node_name, publisher.node_namespace) == ("hexctl", "/")
    assert publisher.type_hash == type_hash("tf2_msgs/msg/TFMessage")
    assert publisher.qos == ":1:,1:,:,:,,"
    (stop,) = node.info("/hexctl/estop").subscribers
    assert stop.type_hash == type_hash(EMPTY)
    assert {one.topic_type for one in node.info("/cmd_vel").subscribers} == {TWIST, TWIST_STAMPED}


def test_joints_and_odometry_are_echoed(network: tuple[Served, Peer]) -> None:
    _, node = network
    joints = node.subscribed("/joint_states", ros_cdr.JOINT_STATE)
    poses = node.subscribed("/odom", ros_cdr.ODOMETRY)
    wait_until(lambda: len(joints) > 20 and len(poses) > 20, "states")
    assert tuple(joints[-1].name) == JOINT_NAMES
    assert np.isfinite(joints[-1].position).all()
    assert poses[-1].header.frame_id == "odom"
    assert poses[-1].child_frame_id == "base_link"
    stamps = [one.header.stamp.sec + 1e-9 * one.header.stamp.nanosec for one in poses]
    assert np.median(np.diff(stamps)) == pytest.approx(0.02, rel=0.2)


def test_transforms_hang_together_and_the_description_is_latched(network: tuple[Served, Peer]) -> None:
    _, node = network
    moving = node.subscribed("/tf", telemetry.TRANSFORMS)
    latched: dict[str, Any] = {}

    def latch(topic: str, kind: str) -> Any:
        return zenoh.ext.declare_advanced_subscriber(
            node.session,
            data_key(topic, kind),
            lambda sample: latched.update({topic: decoded(kind, bytes(sample.payload))}),
            history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
        )

    kinds = {"robot_description": telemetry.STRING, "tf_static": telemetry.TRANSFORMS}
    subscribers = [latch(topic, kind) for topic, kind in kinds.items()]
    wait_until(lambda: moving and len(latched) == 2, "transforms and the description")
    for each in subscribers:
        each.undeclare()
    parents = {one.child_frame_id: one.header.frame_id for one in moving[-1].transforms}
    assert parents["base_link"] == "odom"
    assert parents["leg3_tibia_link"] == "leg3_femur_link"
    fixed = {one.child_frame_id: one.header.frame_id for one in latched["tf_static"].transforms}
    model = yourdfpy.URDF.load(
        io.BytesIO(latched["robot_description"].data.encode()), build_scene_graph=False, load_meshes=False
    )
    links = {link.name for link in model.robot.links}
    assert {"odom", *parents, *fixed} == links | {"odom"}


def test_every_byte_of_an_attachment(network: tuple[Served, Peer]) -> None:
    samples = hear_joints(network[1].session)
    (token,) = network[1].tokens("@ros2_lv/0/*/0/*/MP/%/%/hexctl/%joint_states/**")
    data = [bytes(sample.attachment) for sample in samples]
    numbers = [int.from_bytes(one[:8], "little") for one in data]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    for one in data:
        assert len(one) == SIZE
        stamp_ns = int.from_bytes(one[8:16], "little")
        assert 1.7e18 < stamp_ns < 4e18
        assert one[16] == 16
        assert one[17:] == xxhash.xxh3_128_digest(token.encode())[::-1]


def say_velocity(node: Peer, publisher: Any, kind: str, forward: float) -> None:
    """Publish a velocity of one type, as teleop_twist_keyboard or Nav2 do."""
    linear, angular = (node.make(VECTOR, x=share, y=0.0, z=0.0) for share in (forward, 0.0))
    if kind == TWIST:
        publisher.publish(linear=linear, angular=angular)
        return
    stamp = node.make("builtin_interfaces/msg/Time", sec=0, nanosec=0)  # as the newer teleop leaves it
    header = node.make("std_msgs/msg/Header", stamp=stamp, frame_id="base_link")
    publisher.publish(header=header, twist=node.make(TWIST, linear=linear, angular=angular))


def answers(session: zenoh.Session, key: str, payload: bytes) -> list[bytes]:
    """Payloads of the answers of a service, each under the request's number and identifier."""
    asked = Attachment(7, time.time_ns(), bytes(range(16))).packed()
    samples = [reply.ok for reply in session.get(key, payload=payload, attachment=asked) if reply.ok]
    for sample in samples:
        answered = Attachment.unpacked(bytes(sample.attachment or b""))
        assert (answered.sequence, answered.gid) == (7, bytes(range(16)))
    return [bytes(sample.payload) for sample in samples]


def call(session: zenoh.Session, service: str) -> tuple[bool, str]:
    """Answer of a service without fields."""
    key = RosEndpoint(RosNode(), Kind.SERVICE, f"~/{service}", "std_srvs/srv/Trigger", 0).key
    (payload,) = answers(session, key, b"\0\1\0\0\0")
    return bool(payload[4]), payload[12:-1].decode()


def test_parameters_are_listed_set_and_read_back(network: tuple[Served, Peer]) -> None:
    session = network[1].session
    for service in ParameterService:
        token = f"@ros2_lv/0/*/0/*/SS/%/%/hexctl/%hexctl%{service.value}/**"
        assert network[1].tokens(token)[0].endswith("/::,1000:,:,:,,")

    def asked(service: ParameterService, payload: bytes) -> bytes:
        (answer,) = answers(session, parameter_endpoint(RosNode(), service).key, payload)
        return answer

    wish = request(ParameterService.SET, **wishes(sit_after=60.0, gait="gallop"))
    (done, refused) = decoded_answer(ParameterService.SET, asked(ParameterService.SET, wish))
    assert (done.successful, refused.successful) == (True, False)
    assert "tripod" in refused.reason
    read = request(ParameterService.GET, **named("sit_after", "gait"))
    values = decoded_answer(ParameterService.GET, asked(ParameterService.GET, read))
    assert (values[0].double_value, values[1].string_value) == (60.0, "tripod")
    key = parameter_endpoint(RosNode(), ParameterService.GET).key
    before = network[0].status()["ros"]["malformed"]
    assert answers(session, key, b"\0\1\0\0garbage") == []
    wait_until(lambda: network[0].status()["ros"]["malformed"] > before, "the count")


@pytest.mark.parametrize("kind", [TWIST, TWIST_STAMPED])
def test_a_velocity_moves_the_robot_and_silence_stops_it(network: tuple[Served, Peer], kind: str) -> None:
    robot, node = network
    poses = node.subscribed("/odom", ros_cdr.ODOMETRY)
    publisher = node.publisher("/cmd_vel", kind)
    wait_until(lambda: poses, "a pose")
    start = poses[-1].pose.pose.position.x

    def walks() -> bool:
        say_velocity(node, publisher, kind, 0.08)
        time.sleep(0.05)
        walked_m = poses[-1].pose.pose.position.x - start
        return bool(walked_m > 0.1 and robot.status()["controller"] == "ROS 2")

    wait_until(walks, "10 cm of walking under the lease of ROS")
    fastest = max(one.twist.twist.linear.x for one in poses)
    assert 0.02 < fastest < 0.4
    wait_until(lambda: robot.status()["controller"] is None, "the end of the lease")
    wait_until(lambda: abs(poses[-1].twist.twist.linear.x) < 0.01, "a stand")
    assert robot.status()["stopped"] is None


def test_a_stop_is_always_taken(network: tuple[Served, Peer]) -> None:
    robot, node = network
    assert call(node.session, "stand") == (True, "standing up")
    node.publisher("/hexctl/estop", EMPTY).publish()
    wait_until(lambda: robot.status()["stopped"] == "estop", "the stop")
    assert robot.status()["ros"]["stops"] == 1
    assert not call(node.session, "stand")[0]
    wait_until(lambda: call(node.session, "clear_stop") == (True, "no longer stopped"), "the end of its hold")
    assert call(node.session, "sit")[0]
    wait_until(lambda: robot.status()["posture"] == "limp", "a robot that sits")


def test_garbage_on_every_topic_moves_nothing(network: tuple[Served, Peer]) -> None:
    robot, node = network
    call(node.session, "clear_stop")
    chance = np.random.default_rng(3)
    for topic, kind in (
        ("cmd_vel", TWIST),
        ("cmd_vel", TWIST_STAMPED),
        ("robot_joint_command", ros_cdr.JOINT_STATE),
        ("body_pose", POSE),
    ):
        key = data_key(topic, kind)
        for _ in range(1000):
            node.session.put(key, b"\0\1\0\0" + chance.bytes(int(chance.integers(0, 40))))
        node.session.put(key, bytes(200_000))
    wait_until(lambda: robot.status()["ros"]["malformed"] > 3, "the count")
    status = robot.status()
    assert status["controller"] is None
    assert status["ros"]["commands"] > 0
    assert status["overruns"] < status["ticks"] / 10


def test_a_robot_of_humble_has_humbles_keys_in_its_namespace(tmp_path: Path) -> None:
    port = free_port()
    humble = ("--ros-humble", "--ros-namespace", "lab/ant", "--ros-domain", "3")
    options = ("--ros", f"tcp/127.0.0.1:{port}", *humble)
    with router(port) as session, served(tmp_path, *options, backend="mock") as robot:
        keys: list[str] = []
        found = session.declare_subscriber(
            "3/lab/ant/joint_states/**", lambda one: keys.append(str(one.key_expr))
        )
        wait_until(lambda: keys, "joint states")
        assert keys[0].endswith("/sensor_msgs::msg::dds_::JointState_/TypeHashNotSupported")
        found.undeclare()  # type: ignore[no-untyped-call]
        wait_until(lambda: robot.status()["ros"]["connected"], "the router in the status")


def test_a_router_that_goes_and_returns_is_found_again(tmp_path: Path) -> None:
    port = free_port()
    with served(tmp_path, "--ros", f"tcp/127.0.0.1:{port}", backend="mock") as robot:
        for times in (1, 2):
            with router(port) as session:
                hear_joints(session)
                success, why = call(session, "stand")
                assert not success
                assert "--ros-drive" in why
                wait_until(lambda: robot.said().count("found") >= times, "the line on the router")  # noqa: B023
            wait_until(lambda: not robot.status()["ros"]["connected"], "the loss of the router")
        robot.wait_for("no ROS router at")
        assert robot.status()["overruns"] <= robot.status()["ticks"] // 10
