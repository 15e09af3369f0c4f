"""A robot in the simulation that a ROS peer of another project drives through a router."""

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from hexctl.types import JOINT_NAMES
from hexctl.wire import ros_cdr
from hexctl.wire.ros.endpoints import Attachment
from hexctl.wire.ros.ros_names import Kind, RosEndpoint, RosNode
from hexctl.wire.ros.velocity import TWIST, TWIST_STAMPED
from tests.server.processes import Served, free_port, served, wait_until
from tests.server.ros.peer import Peer, peer, router

pytestmark = pytest.mark.realtime

VECTOR = "geometry_msgs/msg/Vector3"


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Served, Peer]]:
    """A robot in the simulation that ROS may drive, and a peer."""
    port = free_port()
    folder = tmp_path_factory.mktemp("ros")
    options = ("--ros", f"tcp/127.0.0.1:{port}", "--ros-drive")
    with router(port), served(folder, *options, backend="sim") as robot, peer(port) as node:
        yield robot, node


class Wheel:
    """Publishes a velocity of one type, as teleop_twist_keyboard or Nav2 do."""

    def __init__(self, node: Peer, kind: str) -> None:
        self._node, self._kind = node, kind
        self._publisher = node.publisher("/cmd_vel", kind)

    def say(self, forward: float, turn: float = 0.0) -> None:
        """Publish a velocity once."""
        make = self._node.make
        linear = make(VECTOR, x=forward, y=0.0, z=0.0)
        angular = make(VECTOR, x=0.0, y=0.0, z=turn)
        if self._kind == TWIST:
            self._publisher.publish(linear=linear, angular=angular)
            return
        stamp = make("builtin_interfaces/msg/Time", sec=0, nanosec=0)  # as the newer teleop leaves it
        header = make("std_msgs/msg/Header", stamp=stamp, frame_id="base_link")
        self._publisher.publish(header=header, twist=make(TWIST, linear=linear, angular=angular))

    def until(self, condition: Any, what: str, forward: float, turn: float = 0.0) -> None:
        """Publish at 20 Hz until something is so."""

        def said() -> bool:
            self.say(forward, turn)
            time.sleep(0.05)
            return bool(condition())

        wait_until(said, what)


def call(node: Peer, service: str) -> tuple[bool, str]:
    """Answer of a service without fields."""
    key = RosEndpoint(RosNode(), Kind.SERVICE, f"~/{service}", "std_srvs/srv/Trigger", 0).key
    asked = Attachment(1, time.time_ns(), bytes(16)).packed()
    replies = node.session.get(key, payload=b"\0\1\0\0\0", attachment=asked)
    (sample,) = [reply.ok for reply in replies if reply.ok is not None]
    payload = bytes(sample.payload)
    return bool(payload[4]), payload[12:-1].decode()


def test_it_says_at_its_start_who_may_drive(network: tuple[Served, Peer]) -> None:
    assert "may drive this robot" in network[0].said()


@pytest.mark.parametrize("kind", [TWIST, TWIST_STAMPED])
def test_both_kinds_of_velocity_are_subscribed_to(network: tuple[Served, Peer], kind: str) -> None:
    wait_until(lambda: kind in network[1].topics().get("/cmd_vel", ()), "the topic in the list")
    assert kind in {one.topic_type for one in network[1].info("/cmd_vel").subscribers}


@pytest.mark.parametrize("kind", [TWIST, TWIST_STAMPED])
def test_a_velocity_moves_the_robot_and_silence_stops_it(network: tuple[Served, Peer], kind: str) -> None:
    robot, node = network
    poses = node.subscribed("/odom", ros_cdr.ODOMETRY)
    wheel = Wheel(node, kind)
    wait_until(lambda: poses, "a pose")
    start = poses[-1].pose.pose.position.x
    wheel.until(lambda: poses[-1].pose.pose.position.x > start + 0.1, "10 cm of walking", 0.08)
    wheel.until(lambda: robot.status()["controller"] == "ROS 2", "the lease of ROS", 0.08)
    fastest = max(one.twist.twist.linear.x for one in poses)
    assert 0.02 < fastest < 0.4
    wait_until(lambda: robot.status()["controller"] is None, "the end of the lease")
    wait_until(lambda: abs(poses[-1].twist.twist.linear.x) < 0.01, "a stand")
    assert robot.status()["stopped"] is None


def test_a_turn_is_positive_to_the_left(network: tuple[Served, Peer]) -> None:
    _, node = network
    poses = node.subscribed("/odom", ros_cdr.ODOMETRY)
    wheel = Wheel(node, TWIST)
    wait_until(lambda: poses, "a pose")

    def yaw() -> float:
        turned = poses[-1].pose.pose.orientation
        return float(np.arctan2(2 * (turned.w * turned.z + turned.x * turned.y), 1 - 2 * turned.z**2))

    start = yaw()
    wheel.until(lambda: yaw() > start + 0.2, "a turn", 0.0, 0.5)
    wheel.say(0.0)


def test_stop_clear_stand_and_sit(network: tuple[Served, Peer]) -> None:
    robot, node = network
    assert call(node, "stand") == (True, "standing up")
    node.publisher("/hexctl/estop", "std_msgs/msg/Empty").publish()
    wait_until(lambda: robot.status()["stopped"] == "estop", "the stop")
    assert not call(node, "stand")[0]
    wait_until(lambda: call(node, "clear_stop") == (True, "no longer stopped"), "the end of its hold")
    assert call(node, "sit")[0]
    wait_until(lambda: robot.status()["posture"] == "limp", "a robot that sits")


def test_joints_are_commanded_as_ros2_control_does(network: tuple[Served, Peer]) -> None:
    robot, node = network
    states = node.subscribed("/joint_states", ros_cdr.JOINT_STATE)
    publisher = node.publisher("/robot_joint_command", ros_cdr.JOINT_STATE)
    wait_until(lambda: states, "joint states")
    names = list(reversed(JOINT_NAMES))
    stamp = node.make("builtin_interfaces/msg/Time", sec=0, nanosec=0)
    wanted = dict(zip(states[-1].name, states[-1].position, strict=True))
    wanted["leg3_tibia"] -= 0.1
    none = np.zeros(0)

    def arrived() -> bool:
        publisher.publish(
            header=node.make("std_msgs/msg/Header", stamp=stamp, frame_id=""),
            name=names,
            position=np.array([wanted[name] for name in names]),
            velocity=none,
            effort=none,
        )
        time.sleep(0.02)
        now = dict(zip(states[-1].name, states[-1].position, strict=True))
        return bool(abs(now["leg3_tibia"] - wanted["leg3_tibia"]) < 0.03)

    wait_until(arrived, "the joint's angle")
    assert robot.status()["ros"]["motion"] == "joints"
    wait_until(lambda: robot.status()["stopped"] == "expired", "the freeze after the last command")


def test_garbage_on_every_topic_moves_nothing(network: tuple[Served, Peer]) -> None:
    robot, node = network
    call(node, "clear_stop")
    chance = np.random.default_rng(3)
    for topic, kind in (
        ("cmd_vel", TWIST),
        ("cmd_vel", TWIST_STAMPED),
        ("robot_joint_command", ros_cdr.JOINT_STATE),
    ):
        key = RosEndpoint(RosNode(), Kind.PUBLISHER, topic, kind, 0).key
        for _ in range(1000):
            node.session.put(key, b"\0\1\0\0" + chance.bytes(int(chance.integers(0, 40))))
        node.session.put(key, bytes(200_000))
    wait_until(lambda: robot.status()["ros"]["malformed"] > 2, "the count")
    status = robot.status()
    assert status["controller"] is None
    assert status["ros"]["commands"] > 0
    assert status["overruns"] < status["ticks"] / 10
