"""Zenoh session of a ROS 2 node, configured as rmw_zenoh does: a peer of the nodes that a router knows."""

import socket

import zenoh

from hexctl.errors import InputError, argument
from hexctl.wire.links import Endpoint
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

    def trouble(self, found: bool, now_s: float) -> str | None:
        """Why there is no router, with a next step; None if it is reached or may still be starting."""
        if found or not _listens(self._router):
            self._listens_since_s = None
            self._lost |= found
            return None if found else self._absent
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
