"""Publishers, subscriptions and services of a ROS 2 node, each with the token by which others see it."""

import struct
import time
from dataclasses import dataclass
from typing import Any

import zenoh
import zenoh.ext

from hexctl.errors import MessageError
from hexctl.wire.ros.ros_names import GID_BYTES, RosEndpoint

_LAYOUT = struct.Struct(f"<qqB{GID_BYTES}s")

#: Bytes of an attachment.
SIZE = _LAYOUT.size


@dataclass(frozen=True, slots=True)
class Attachment:
    """Attachment of a message, a request or an answer.

    Attributes:
        sequence: 1 for the first message of a publisher, then growing by one; an answer has that of its
            request.
        stamp_ns: time of sending, nanoseconds since 1970.
        gid: identifier of the sender, 16 bytes; an answer has that of its request.
    """

    sequence: int
    stamp_ns: int
    gid: bytes

    def packed(self) -> bytes:
        """The 33 bytes: two signed integers of 8, the length of the identifier, the identifier."""
        return _LAYOUT.pack(self.sequence, self.stamp_ns, GID_BYTES, self.gid)

    @classmethod
    def unpacked(cls, data: bytes) -> "Attachment":
        """Attachment of 33 bytes.

        Raises MessageError for anything else.
        """
        if len(data) != SIZE or data[16] != GID_BYTES:
            raise MessageError(f"ROS attachment: got {len(data)} bytes; allowed: {SIZE} with a gid of 16")
        sequence, stamp_ns, _, gid = _LAYOUT.unpack(data)
        return cls(sequence, stamp_ns, gid)


#: A latched publisher says this often what it sent last, so that a subscriber notices what it has missed.
HEARTBEAT_S = 0.5

#: Requests of a service that wait; a flood of them replaces the oldest.
WAITING_REQUESTS = 4


class RosPublisher:
    """A publisher: numbers its messages and attaches who sent them and when.

    Args:
        session: open.
        endpoint: of the kind `PUBLISHER`; a latched one keeps its last messages for later subscribers.
    """

    def __init__(self, session: zenoh.Session, endpoint: RosEndpoint) -> None:
        session_id = str(session.info.zid())
        self._gid = endpoint.gid(session_id)
        self._sequence = 0
        self._latched = endpoint.qos.latched
        self._publisher = _publisher(session, endpoint)
        self._token = session.liveliness().declare_token(endpoint.token(session_id))

    @property
    def wanted(self) -> bool:
        """Whether anything subscribes to it now; a latched one is kept for later."""
        return self._latched or bool(self._publisher.matching_status.matching)

    def put(self, payload: bytes) -> None:
        """Publish a message; never waits for a slow subscriber."""
        self._sequence += 1
        attachment = Attachment(self._sequence, time.time_ns(), self._gid).packed()
        self._publisher.put(payload, attachment=attachment)


def _publisher(session: zenoh.Session, endpoint: RosEndpoint) -> Any:
    options: dict[str, Any] = {
        "congestion_control": zenoh.CongestionControl.DROP,
        "reliability": zenoh.Reliability.RELIABLE,
    }
    if not endpoint.qos.latched:
        return session.declare_publisher(endpoint.key, **options)
    return zenoh.ext.declare_advanced_publisher(
        session,
        endpoint.key,
        **options,
        cache=zenoh.ext.CacheConfig(endpoint.qos.depth),
        publisher_detection=True,
        sample_miss_detection=zenoh.ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=HEARTBEAT_S),
    )


class RosSubscription:
    """A subscription that keeps the newest message only.

    It keeps it outside Python: a flood of messages costs the robot's process nothing but the newest one.

    Args:
        session: open.
        endpoint: of the kind `SUBSCRIPTION`.
    """

    def __init__(self, session: zenoh.Session, endpoint: RosEndpoint) -> None:
        self._subscriber = session.declare_subscriber(endpoint.key, zenoh.handlers.RingChannel(1))
        self._token = session.liveliness().declare_token(endpoint.token(str(session.info.zid())))

    def newest(self) -> bytes | None:
        """Payload of the newest message, once; None when none has come since."""
        sample = self._subscriber.try_recv()
        return None if sample is None else bytes(sample.payload)


class RosRequest:
    """A request that waits for its answer.

    Args:
        query: of Zenoh.
        attachment: of the request.
    """

    def __init__(self, query: zenoh.Query, attachment: Attachment) -> None:
        self._query, self._attachment = query, attachment

    def answer(self, payload: bytes) -> None:
        """Answer it, under its number and its sender's identifier, and let it go."""
        attachment = Attachment(self._attachment.sequence, time.time_ns(), self._attachment.gid)
        try:
            self._query.reply(self._query.key_expr, payload, attachment=attachment.packed())
        except zenoh.ZError:
            pass  # the client has gone
        finally:
            self._query.drop()  # type: ignore[no-untyped-call]


class RosService:
    """A service whose requests are taken one by one.

    Args:
        session: open.
        endpoint: of the kind `SERVICE`.
    """

    def __init__(self, session: zenoh.Session, endpoint: RosEndpoint) -> None:
        channel: Any = zenoh.handlers.RingChannel(WAITING_REQUESTS)
        self._queryable = session.declare_queryable(endpoint.key, channel, complete=True)
        self._token = session.liveliness().declare_token(endpoint.token(str(session.info.zid())))
        self._malformed = 0

    def next_request(self) -> RosRequest | None:
        """The oldest request that waits, or None."""
        while (query := self._queryable.try_recv()) is not None:
            try:
                attachment = Attachment.unpacked(b"" if query.attachment is None else bytes(query.attachment))
            except MessageError:
                self._malformed += 1
                query.drop()  # type: ignore[no-untyped-call]
            else:
                return RosRequest(query, attachment)
        return None

    def take_malformed(self) -> int:
        """How many requests without the attachment of a ROS client have come since this was asked last.

        They are not answered.
        """
        taken, self._malformed = self._malformed, 0
        return taken
