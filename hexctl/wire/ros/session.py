"""Zenoh session of a ROS 2 node: as rmw_zenoh configures it, a peer of the nodes that a router knows."""

import json
import socket
from typing import Any

import zenoh

from hexctl.errors import InputError, argument
from hexctl.wire.links import Endpoint
from hexctl.wire.session import MAX_MESSAGE_BYTES, RETRY_MS

#: How long a look at a router takes at most.
PROBE_TIMEOUT_S = 0.2


def check_router(text: str, *, insecure: bool) -> Endpoint:
    """Endpoint of a ROS router.

    Raises InputError for one that is malformed or of another protocol than tcp, and for one beyond this
    computer unless that is allowed: every client on that network may stop the robot, and drive it where
    driving is on.
    """
    endpoint = Endpoint.parse(text)
    if endpoint.protocol != "tcp":
        raise InputError(f"{argument('ros')}: got {text}; allowed: tcp/HOST:PORT, as rmw_zenoh's router has")
    if endpoint.is_everywhere:
        raise InputError(f"{argument('ros')}: got {text}; allowed: the router's own address")
    if not (endpoint.is_loopback or insecure):
        raise InputError(
            f"{argument('ros')}: {text} is beyond this computer, and ROS asks for no certificates; "
            f"run a router here that connects to it, or give {argument('insecure')} deliberately"
        )
    return endpoint


def why_no_router(router: Endpoint) -> str:
    """Reason why a router is not reached, and what to do about it."""
    try:
        with socket.create_connection((router.host, router.port), timeout=PROBE_TIMEOUT_S):
            return (
                f"what listens at {router} is no ROS router; if it is hexctl serve, give that another port "
                f"with {argument('listen')}"
            )
    except OSError:
        return f"no ROS router at {router} yet; ros2 run rmw_zenoh_cpp rmw_zenohd starts one"


def open_ros_session(router: Endpoint) -> zenoh.Session:
    """Open a session that reaches a router as soon as there is one, and returns to it after a loss."""
    config = zenoh.Config()
    for key, value in _settings(router).items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def _settings(router: Endpoint) -> dict[str, Any]:
    return {
        "mode": "peer",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": True,
        # A free port, for nodes of this computer: the router tells them of it.
        "listen/endpoints": ["tcp/127.0.0.1:0"],
        "connect/endpoints": [str(router)],
        # Opening does not wait for a router, and trying never ends.
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 200, "period_max_ms": RETRY_MS, "period_increase_factor": 2.0},
        # Latched topics need it.
        "timestamping/enabled": True,
        "transport/link/rx/max_message_size": MAX_MESSAGE_BYTES,
        "transport/shared_memory/enabled": False,
    }
