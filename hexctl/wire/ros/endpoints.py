"""Publishers, subscriptions and services of a ROS 2 node, each with its liveliness token."""

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
    """Attachment of a message, a request or an answer, which repeats its request's number and identifier.

    Attributes:
        sequence: counts the messages of a publisher from 1.
        stamp_ns: time of sending, nanoseconds since 1970.
        gid: identifier of the sender, 16 bytes.
    """

    sequence: int
    stamp_ns: int
    gid: bytes

    def packed(self) -> bytes:
        """The 33 bytes: two signed integers of 8, the length of the identifier, the identifier."""
        return _LAYOUT.pack(self.sequence, self.stamp_ns, GID_BYTES, self.gid)

    @classmethod
    def unpacked(cls, data: bytes) -> "Attachment":
        """Attachment of 33 bytes; raises MessageError for anything else."""
        if len(data) != SIZE or data[16] != GID_BYTES:
            raise MessageError(f"ROS attachment: got {len(data)} bytes; allowed: {SIZE} with a gid of 16")
        sequence, stamp_ns, _, gid = _LAYOUT.unpack(data)
        return cls(sequence, stamp_ns, gid)


#: Period in which a latched publisher announces its last message, for subscribers that missed it.
HEARTBEAT_S = 0.5

#: Maximum number of waiting requests; a flood replaces the oldest.
WAITING_REQUESTS = 4


class RosPublisher:
    """A publisher: numbers its messages and attaches sender and time; latched ones keep their last."""

    def __init__(self, session: zenoh.Session, endpoint: RosEndpoint) -> None:
        session_id = str(session.info.zid())
        self._gid = endpoint.gid(session_id)
        self._sequence = 0
        self._latched = endpoint.qos.latched
        self._publisher = _publisher(session, endpoint)
        self._token = session.liveliness().declare_token(endpoint.token(session_id))

    @property
    def wanted(self) -> bool:
        """Whether it has subscribers; always True for a latched one."""
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
    """A subscription that keeps only the newest message, outside Python: a flood costs the process little."""

    def __init__(self, session: zenoh.Session, endpoint: RosEndpoint) -> None:
        self._subscriber = session.declare_subscriber(endpoint.key, zenoh.handlers.RingChannel(1))
        self._token = session.liveliness().declare_token(endpoint.token(str(session.info.zid())))

    def newest(self) -> bytes | None:
        """Payload of the newest message, once; None without a new one."""
        sample = self._subscriber.try_recv()
        return None if sample is None else bytes(sample.payload)


class RosRequest:
    """A request that waits for its answer."""

    def __init__(self, query: zenoh.Query, attachment: Attachment) -> None:
        self._query, self._attachment = query, attachment

    @property
    def payload(self) -> bytes:
        """The request in CDR; empty without one."""
        return b"" if self._query.payload is None else bytes(self._query.payload)

    def refuse(self) -> None:
        """Release it without an answer, as ROS does with a request that it cannot read."""
        self._query.drop()  # type: ignore[no-untyped-call]

    def answer(self, payload: bytes) -> None:
        """Answer it, under its number and its sender's identifier, and release it."""
        attachment = Attachment(self._attachment.sequence, time.time_ns(), self._attachment.gid)
        try:
            self._query.reply(self._query.key_expr, payload, attachment=attachment.packed())
        except zenoh.ZError:
            pass  # the client has disconnected
        finally:
            self._query.drop()  # type: ignore[no-untyped-call]


class RosService:
    """A service whose requests are taken one by one."""

    def __init__(self, session: zenoh.Session, endpoint: RosEndpoint) -> None:
        channel: Any = zenoh.handlers.RingChannel(WAITING_REQUESTS)
        self._queryable = session.declare_queryable(endpoint.key, channel, complete=True)
        self._token = session.liveliness().declare_token(endpoint.token(str(session.info.zid())))
        self._malformed = 0

    def next_request(self) -> RosRequest | None:
        """The oldest waiting request, or None."""
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
        """Number of unanswered requests without a ROS client's attachment since the last call."""
        taken, self._malformed = self._malformed, 0
        return taken
