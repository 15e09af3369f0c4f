"""A served robot in ROS 2, seen by a peer of another project through a router: no ROS here."""

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xxhash
import yourdfpy
import zenoh
import zenoh.ext

from hexctl.types import JOINT_NAMES
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.robot_link import robot_link
from hexctl.wire import ros_cdr
from hexctl.wire.links import Link
from hexctl.wire.ros import telemetry
from hexctl.wire.ros.endpoints import SIZE, Attachment
from hexctl.wire.ros.ros_names import Kind, RosEndpoint, RosNode, type_hash
from tests.server.processes import Served, free_port, served, wait_until
from tests.server.ros.peer import Peer, peer, router
from tests.wire.ros.decoding import decoded

pytestmark = pytest.mark.realtime

EMPTY = "std_msgs/msg/Empty"

#: What `ros2 topic list -t` shows of a robot that ROS may not drive.
TOPICS = {
    "/joint_states": ["sensor_msgs/msg/JointState"],
    "/odom": ["nav_msgs/msg/Odometry"],
    "/tf": ["tf2_msgs/msg/TFMessage"],
    "/tf_static": ["tf2_msgs/msg/TFMessage"],
    "/imu/data": ["sensor_msgs/msg/Imu"],
    "/battery_state": ["sensor_msgs/msg/BatteryState"],
    "/diagnostics": ["diagnostic_msgs/msg/DiagnosticArray"],
    "/robot_description": ["std_msgs/msg/String"],
    "/hexctl/estop": ["std_msgs/msg/Empty"],
}


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Served, Peer]]:
    """A robot in the simulation that was there before its router, and a peer."""
    port = free_port()
    folder = tmp_path_factory.mktemp("ros")
    options = ("--ros", f"tcp/127.0.0.1:{port}")
    with served(folder, *options, backend="sim") as robot, router(port), peer(port) as node:
        yield robot, node


def data_key(topic: str, kind: str) -> str:
    return RosEndpoint(RosNode(), Kind.PUBLISHER, topic, kind, 0).key


def test_topics_are_listed_with_their_types(network: tuple[Served, Peer]) -> None:
    wait_until(lambda: network[1].topics() == TOPICS, "the list")


def test_the_info_of_a_topic_says_who_and_how(network: tuple[Served, Peer]) -> None:
    info = network[1].info("/tf_static")
    (publisher,) = info.publishers
    assert (publisher.node_name, publisher.node_namespace) == ("hexctl", "/")
    assert publisher.type_hash == type_hash("tf2_msgs/msg/TFMessage")
    assert publisher.qos == ":1:,1:,:,:,,"
    (stop,) = network[1].info("/hexctl/estop").subscribers
    assert stop.type_hash == type_hash(EMPTY)


def test_the_node_is_listed(network: tuple[Served, Peer]) -> None:
    assert len(network[1].tokens("@ros2_lv/0/*/0/0/NN/%/%/hexctl")) == 1


def test_joints_and_odometry_are_echoed(network: tuple[Served, Peer]) -> None:
    _, node = network
    joints = node.subscribed("/joint_states", ros_cdr.JOINT_STATE)
    poses = node.subscribed("/odom", ros_cdr.ODOMETRY)
    wait_until(lambda: len(joints) > 50 and len(poses) > 50, "a second of states")
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
    assert {"odom", *parents, *fixed} == links - {"base_link"} | {"base_link", "odom"}


def test_every_byte_of_an_attachment(network: tuple[Served, Peer]) -> None:
    session = network[1].session
    samples: list[Any] = []
    subscriber = session.declare_subscriber(data_key("joint_states", ros_cdr.JOINT_STATE), samples.append)
    wait_until(lambda: len(samples) > 5, "joint states")
    subscriber.undeclare()  # type: ignore[no-untyped-call]
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


def test_a_publisher_counts_from_one(network: tuple[Served, Peer]) -> None:
    session = network[1].session
    samples: list[Any] = []
    subscriber = session.declare_subscriber(data_key("imu/data", ros_cdr.IMU), samples.append)
    wait_until(lambda: samples, "an orientation")
    subscriber.undeclare()  # type: ignore[no-untyped-call]
    assert Attachment.unpacked(bytes(samples[0].attachment)).sequence == 1
    message = decoded(ros_cdr.IMU, bytes(samples[0].payload))
    assert message.orientation.w == pytest.approx(1.0, abs=0.05)
    assert message.angular_velocity_covariance[0] == -1


def test_battery_and_diagnostics_come_once_a_second(network: tuple[Served, Peer]) -> None:
    _, node = network
    told = node.subscribed("/diagnostics", telemetry.DIAGNOSTICS)
    batteries = node.subscribed("/battery_state", ros_cdr.BATTERY_STATE)
    wait_until(lambda: len(told) > 2 and batteries, "diagnostics")
    stamps = [one.header.stamp.sec + 1e-9 * one.header.stamp.nanosec for one in told]
    assert np.median(np.diff(stamps)) == pytest.approx(1.0, rel=0.3)
    assert told[-1].status[0].name == "hexctl: robot"
    assert np.isnan(batteries[-1].voltage)


def test_services_say_that_driving_is_off(network: tuple[Served, Peer]) -> None:
    key = RosEndpoint(RosNode(), Kind.SERVICE, "~/stand", "std_srvs/srv/Trigger", 0).key
    asked = Attachment(7, 1, bytes(range(16))).packed()
    replies = list(network[1].session.get(key, payload=b"\0\1\0\0\0", attachment=asked))
    (sample,) = [reply.ok for reply in replies if reply.ok is not None]
    answered = Attachment.unpacked(bytes(sample.attachment or b""))
    assert (answered.sequence, answered.gid) == (7, bytes(range(16)))
    assert bytes(sample.payload)[4] == 0
    assert b"--ros-drive" in bytes(sample.payload)


def test_a_stop_is_always_taken(network: tuple[Served, Peer]) -> None:
    robot, node = network
    assert robot.status()["stopped"] is None
    node.publisher("/hexctl/estop", EMPTY).publish()
    wait_until(lambda: robot.status()["stopped"] == "estop", "the stop")
    assert robot.status()["ros"]["stops"] == 1


def test_a_robot_of_humble_has_humbles_keys_in_its_namespace(tmp_path: Path) -> None:
    port = free_port()
    options = (
        "--ros",
        f"tcp/127.0.0.1:{port}",
        "--ros-humble",
        "--ros-namespace",
        "lab/ant",
        "--ros-domain",
        "3",
    )
    with router(port) as session, served(tmp_path, *options, backend="mock") as robot:
        keys: list[str] = []
        found = session.declare_subscriber(
            "3/lab/ant/joint_states/**", lambda one: keys.append(str(one.key_expr))
        )
        wait_until(lambda: keys, "joint states")
        assert keys[0].endswith("/sensor_msgs::msg::dds_::JointState_/TypeHashNotSupported")
        found.undeclare()  # type: ignore[no-untyped-call]
        wait_until(lambda: robot.status()["ros"]["connected"], "the router in the status")


def hear_joints(session: zenoh.Session) -> None:
    """Wait for joint states."""
    got: list[Any] = []
    found = session.declare_subscriber(data_key("joint_states", ros_cdr.JOINT_STATE), got.append)
    wait_until(lambda: len(got) > 10, "joint states")
    found.undeclare()  # type: ignore[no-untyped-call]


def test_a_router_that_goes_and_returns_is_found_again(tmp_path: Path) -> None:
    port = free_port()
    with served(tmp_path, "--ros", f"tcp/127.0.0.1:{port}", backend="mock") as robot:
        for times in (1, 2):
            with router(port) as session:
                hear_joints(session)
                wait_until(lambda: robot.said().count("found") >= times, "the line on the router")  # noqa: B023
            wait_until(lambda: not robot.status()["ros"]["connected"], "the loss of the router")
        robot.wait_for("no ROS router at")
        assert robot.status()["overruns"] <= robot.status()["ticks"] // 10


def test_a_pose_from_outside_is_in_map(tmp_path: Path) -> None:
    port = free_port()
    options = ("--ros", f"tcp/127.0.0.1:{port}")
    with router(port) as session, served(tmp_path, *options, backend="mock") as robot:
        frames: dict[str, Any] = {}

        def take(sample: Any) -> None:
            told = decoded(telemetry.TRANSFORMS, bytes(sample.payload)).transforms
            frames.update({one.child_frame_id: one for one in told})

        found = session.declare_subscriber(data_key("tf", telemetry.TRANSFORMS), take)
        wait_until(lambda: frames, "transforms")
        assert "odom" not in frames
        with robot_link(Link(endpoint=robot.endpoint)) as end:

            def placed(x_m: float) -> bool:
                pose = PlanarPose(x_m, -0.5, 0.7)
                end.publish(pose, 0.12, position_variance_m2=1e-4, yaw_variance_rad2=1e-4)
                if "odom" not in frames:
                    return False
                odom, body = frames["odom"], frames["base_link"]
                assert (odom.header.frame_id, body.header.frame_id) == ("map", "odom")
                assert abs(body.transform.translation.x) < 1e-3  # it stands
                return bool(abs(odom.transform.translation.x - x_m) < 1e-3)

            for x_m in (1.5, 2.5):
                wait_until(lambda: placed(x_m), f"a map with the robot at {x_m} m")  # noqa: B023
        found.undeclare()  # type: ignore[no-untyped-call]
