"""Open Zenoh sessions: a robot's, a controller's, a viewer's. Closed by default."""

import json
from typing import Any

import zenoh

from hexctl.errors import InputError, RobotFaultError
from hexctl.wire.access import access_control
from hexctl.wire.credentials import Credentials, find_credentials
from hexctl.wire.diagnosis import why_not_connected, why_not_listening
from hexctl.wire.endpoint import Endpoint
from hexctl.wire.keys import KeyMap
from hexctl.wire.link import Link
from hexctl.wire.protocol import MAX_PAYLOAD_BYTES
from hexctl.wire.role import Role

#: How long a client tries to reach a robot.
CONNECT_MS = 3000

#: Longest pause between two tries, then and when a robot has gone: it may come back at any time.
RETRY_MS = 1000

#: A peer whose computer hangs or whose cable is pulled is gone after this; Zenoh's own default is 10 s.
LEASE_MS = 1000

#: A busy computer may hold the sending queue for longer than Zenoh's default of 1 ms; a tick is 20 ms.
WAIT_BEFORE_DROP_US = 10_000

#: A robot has a dozen keys; a message of it fits into this with room for keys and attachment.
MAX_MESSAGE_BYTES = 2 * MAX_PAYLOAD_BYTES


def check_link(link: Link, role: Role) -> Endpoint:
    """Return a link's endpoint.

    Raises InputError for one that cannot be, and for one that would be open to strangers.
    """
    endpoint = Endpoint.parse(link.endpoint)
    if endpoint.encrypted and link.credentials is None:
        raise InputError(f"{endpoint}: needs certificates; give --keys FOLDER, made with hexctl keys new")
    if not endpoint.encrypted and link.credentials is not None:
        raise InputError(
            f"{endpoint}: got --keys {link.credentials}, and tcp knows no certificates; "
            f"use tls/{endpoint.place}"
        )
    if not (endpoint.encrypted or endpoint.is_loopback or link.insecure):
        raise InputError(
            f"{endpoint}: goes beyond this computer without certificates; use tls/{endpoint.place} "
            "with --keys FOLDER (hexctl keys new), or say --insecure and mean it"
        )
    if endpoint.is_everywhere and role is not Role.ROBOT:
        raise InputError(
            f"{endpoint}: stands for all addresses, where a robot listens; allowed here: the robot's own, "
            f"on this computer {endpoint.protocol}/127.0.0.1:{endpoint.port}"
        )
    return endpoint


def open_session(link: Link, role: Role, keys: KeyMap) -> zenoh.Session:
    """Open a session; use it in a with statement, a process that does not close it never ends.

    A robot listens at the link's endpoint, everybody else connects to it. Raises InputError for a link that
    is not allowed, and RobotFaultError when there is no way to listen or to connect.
    """
    endpoint = check_link(link, role)
    found = None if link.credentials is None else find_credentials(link.credentials, role)
    config = zenoh.Config()
    for key, value in _settings(endpoint, role, keys, found).items():
        config.insert_json5(key, json.dumps(value))
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        listens = role is Role.ROBOT
        reason = why_not_listening(endpoint) if listens else why_not_connected(endpoint, found)
        raise RobotFaultError(reason) from error


def _settings(endpoint: Endpoint, role: Role, keys: KeyMap, found: Credentials | None) -> dict[str, Any]:
    """Return Zenoh's settings of a session."""
    listens = role is Role.ROBOT
    settings: dict[str, Any] = {
        # A robot is a peer, not a router: it keeps no map of the network that others could write into. Like a
        # router it would pass on what one client says to another, did access control not forbid it.
        "mode": "peer" if listens else "client",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "listen/endpoints": [str(endpoint)] if listens else [],
        "connect/endpoints": [] if listens else [str(endpoint)],
        "connect/timeout_ms": CONNECT_MS,
        "connect/exit_on_failure": True,
        "connect/retry": {"period_init_ms": 100, "period_max_ms": RETRY_MS, "period_increase_factor": 2.0},
        # Whoever connects and says nothing takes up a place no longer than this.
        "transport/unicast/accept_timeout": CONNECT_MS,
        "transport/link/tx/lease": LEASE_MS,
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop": WAIT_BEFORE_DROP_US,
        "transport/link/rx/max_message_size": MAX_MESSAGE_BYTES,
        # Long messages of this computer would come through shared memory, past the limit above.
        "transport/shared_memory/enabled": False,
    }
    if found is not None:
        settings |= _tls(found, "listen" if listens else "connect")
    if listens:
        settings["access_control"] = access_control(keys, certified=found is not None)
    return settings


def _tls(found: Credentials, side: str) -> dict[str, Any]:
    """Return the settings of an encrypted link on which both ends show certificates."""
    return {
        "transport/link/tls/root_ca_certificate": str(found.authority),
        f"transport/link/tls/{side}_certificate": str(found.certificate),
        f"transport/link/tls/{side}_private_key": str(found.key),
        "transport/link/tls/enable_mtls": True,
        "transport/link/tls/verify_name_on_connect": True,
        "transport/link/tls/close_link_on_expiration": True,
    }
