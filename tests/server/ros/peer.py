"""ROS 2 without ROS: a router, and a peer that another project wrote (zenoh-ros2-sdk)."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import zenoh
from zenoh_ros2_sdk import discovery
from zenoh_ros2_sdk.publisher import ROS2Publisher
from zenoh_ros2_sdk.session import ZenohSession
from zenoh_ros2_sdk.subscriber import ROS2Subscriber

from hexctl.wire.ros.ros_names import type_hash
from hexctl.wire.zenoh_session import open_configured
from tests.server.processes import wait_until
from tests.wire.ros.decoding import definition


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
        """Liveliness tokens that a pattern matches, once there are any.

        For a moment after it has connected, a peer may see none.
        """

        def asked() -> list[str]:
            replies = self.session.liveliness().get(pattern, timeout=1.0)
            return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]

        found: list[str] = wait_until(asked, pattern)
        return found

    def info(self, topic: str) -> discovery.TopicInfo:
        """Endpoints of a topic, as `ros2 topic info -v` shows them, once there are any.

        For a moment after it has connected, a peer may see no token.
        """

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
        self._open.append(
            ROS2Subscriber(
                topic,
                kind,
                got.append,
                msg_definition=definition(kind),
                type_hash=type_hash(kind),
                router_port=self._port,
            )
        )
        return got

    def publisher(self, topic: str, kind: str) -> Any:
        publisher = ROS2Publisher(
            topic, kind, msg_definition=definition(kind), type_hash=type_hash(kind), router_port=self._port
        )
        self._open.append(publisher)
        return publisher


@contextmanager
def peer(port: int) -> Iterator[Peer]:
    """A peer that sees the robot's node; the SDK has one session per process."""
    opened = Peer(port)
    try:
        wait_until(lambda: "/joint_states" in opened.topics(), "the robot's topics")
        yield opened
    finally:
        opened.close()
