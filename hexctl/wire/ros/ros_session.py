"""Zenoh session of a ROS 2 node, as rmw_zenoh configures it: publishers, subscriptions and services."""

import socket
import struct
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import zenoh
import zenoh.ext

from hexctl.errors import InputError, MessageError, argument
from hexctl.wire.links import Endpoint
from hexctl.wire.ros.ros_names import GID_BYTES, RosEndpoint
from hexctl.wire.zenoh_session import MAX_MESSAGE_BYTES, RETRY_MS, open_configured

#: Maximum time of a probe of the router.
PROBE_TIMEOUT_S = 0.2

#: A session reaches a new router within this: it retries every second.
GREETING_S = 5.0


def check_router(text: str, *, insecure: bool) -> Endpoint:
    """Endpoint of a ROS router.

    Raises InputError for a malformed one, not tcp, or on another computer without `insecure`: every
    client on that network may stop the robot, and with driving on move it.
    """
    if not text.startswith("tcp/"):
        raise InputError(f"{argument('ros')}: got {text}; allowed: tcp/HOST:PORT, as rmw_zenoh's router has")
    endpoint = Endpoint.parse(text)
    if endpoint.is_everywhere:
        raise InputError(f"{argument('ros')}: got {text}; allowed: the router's own address")
    if not (endpoint.is_loopback or insecure):
        raise InputError(
            f"{argument('ros')}: {text} is beyond this computer, and ROS asks for no certificates; "
            f"run a router here that connects to it, or give {argument('insecure')} deliberately"
        )
    return endpoint


class RouterWatch:
    """Diagnoses why a router is not reached."""

    def __init__(self, router: Endpoint) -> None:
        self._router = router
        self._lost = False
        self._listens_since_s: float | None = None

    def trouble(self, reached: bool, now_s: float) -> str | None:
        """Why there is no router, with a next step; None if it is reached or may still be starting."""
        if reached or not _listens(self._router):
            self._listens_since_s = None
            self._lost |= reached
            return None if reached else self._absent
        if self._listens_since_s is None:
            self._listens_since_s = now_s
        if now_s - self._listens_since_s < GREETING_S:
            return None
        return (
            f"what listens at {self._router} is no ROS router; if it is hexctl serve, give that another port "
            "with --listen"
        )

    @property
    def _absent(self) -> str:
        since = "any more" if self._lost else "yet"
        return f"no ROS router at {self._router} {since}; ros2 run rmw_zenoh_cpp rmw_zenohd starts one"


def _listens(endpoint: Endpoint) -> bool:
    try:
        with socket.create_connection((endpoint.host, endpoint.port), timeout=PROBE_TIMEOUT_S):
            return True
    except OSError:
        return False


def open_ros_session(router: Endpoint) -> zenoh.Session:
    """Open a session that connects to a router once it runs, and reconnects after a loss."""
    settings = {
        "mode": "peer",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": True,
        # A free port, for nodes of this computer: the router announces it to them.
        "listen/endpoints": ["tcp/127.0.0.1:0"],
        "connect/endpoints": [str(router)],
        # Opening does not wait for a router, and retries never end.
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 200, "period_max_ms": RETRY_MS, "period_increase_factor": 2.0},
        # Latched topics need it.
        "timestamping/enabled": True,
        "transport/link/rx/max_message_size": MAX_MESSAGE_BYTES,
        "transport/shared_memory/enabled": False,
    }
    return open_configured(settings)


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
    def subscribed(self) -> bool:
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

    def newest(self) -> tuple[bytes, bytes] | None:
        """Payload of the newest message and identifier of its sender, once; None without a new one.

        The identifier is empty for a message without the attachment of ROS.
        """
        sample = self._subscriber.try_recv()
        if sample is None:
            return None
        sender = b""
        with suppress(MessageError):
            sender = Attachment.unpacked(b"" if sample.attachment is None else bytes(sample.attachment)).gid
        return bytes(sample.payload), sender


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
