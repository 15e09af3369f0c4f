"""Zenoh transport of a served robot: its publishers, and one inbox for all arrivals."""

from collections.abc import Callable
from typing import Any, Self

import zenoh

from hexctl.server.inbox import Inbox
from hexctl.wire.description import encode_json
from hexctl.wire.links import KeyMap, Link, Role
from hexctl.wire.zenoh_messages import prepare_codec
from hexctl.wire.zenoh_session import QUERYABLE, SUBSCRIBED, open_session

#: Priority of each published kind of message.
PRIORITIES = {
    "joint_states": zenoh.Priority.REAL_TIME,
    "odom": zenoh.Priority.REAL_TIME,
    "battery": zenoh.Priority.DATA_LOW,
    "status": zenoh.Priority.DATA,
    "imu": zenoh.Priority.REAL_TIME,
    "truth": zenoh.Priority.DATA,
}


class Transport:
    """A robot's Zenoh session; its callbacks only put arrivals into the inbox.

    Before, on Zenoh's thread: `urgent` gets each payload at `estop`, `admits` the attachment of each command.
    """

    def __init__(
        self,
        link: Link,
        robot_name: str,
        inbox: Inbox,
        urgent: Callable[[bytes], None],
        admits: Callable[[bytes | None], bool],
    ) -> None:
        self._link = link
        self._admits = admits
        self.keys: KeyMap = link.keys(robot_name)
        self._inbox = inbox
        self._urgent = urgent
        self._session: zenoh.Session | None = None
        self._publishers: dict[str, zenoh.Publisher] = {}

    def __enter__(self) -> Self:
        """Open the session; raises InputError for a bad link, RobotFaultError for an unusable address."""
        prepare_codec()
        self._session = open_session(self._link, Role.ROBOT, self.keys)
        try:
            self._declare(self._session)
        except BaseException:
            self._session.close()  # type: ignore[no-untyped-call]
            raise
        return self

    def __exit__(self, *error: object) -> None:
        if self._session is not None:
            self._session.close()  # type: ignore[no-untyped-call]

    def publish(self, kind: str, payload: bytes, attachment: bytes | None = None) -> None:
        """Publish a message; never waits for a slow subscriber."""
        self._publishers[kind].put(payload, attachment=attachment)

    def reply(self, kind: str, query: Any, content: dict[str, Any]) -> None:
        """Answer a query with JSON, under the robot's own key, and release it."""
        try:
            query.reply(getattr(self.keys, kind), encode_json(content))
        except zenoh.ZError:
            pass  # the client has disconnected
        finally:
            query.drop()

    def _declare(self, session: zenoh.Session) -> None:
        for kind, priority in PRIORITIES.items():
            self._publishers[kind] = session.declare_publisher(
                getattr(self.keys, kind),
                congestion_control=zenoh.CongestionControl.DROP,
                priority=priority,
                express=True,
            )
        for kind in SUBSCRIBED:
            session.declare_subscriber(getattr(self.keys, kind), self._putter(kind))
        for kind in QUERYABLE:
            session.declare_queryable(getattr(self.keys, kind), self._putter(kind))

    def _putter(self, kind: str) -> Callable[[Any], None]:
        def put(item: Any) -> None:
            if kind == "estop":
                self._urgent(payload_of(item))
            if kind != "command" or self._admits(attachment_of(item)):
                self._inbox.put(kind, item)

        return put


def payload_of(item: Any) -> bytes:
    """Payload of a sample or a query; empty without one."""
    return bytes(item.payload) if item.payload is not None else b""


def attachment_of(item: Any) -> bytes | None:
    """Attachment of a sample, or None."""
    return bytes(item.attachment) if item.attachment is not None else None
