"""Open Zenoh sessions: a robot's, a controller's, a viewer's. Closed by default."""

import json
import socket
from typing import Any

import zenoh

from hexctl.errors import InputError, RobotFaultError
from hexctl.wire.access import access_control
from hexctl.wire.credentials import find_credentials
from hexctl.wire.endpoint import Endpoint
from hexctl.wire.keys import KeyMap
from hexctl.wire.link import Link
from hexctl.wire.protocol import MAX_PAYLOAD_BYTES
from hexctl.wire.role import Role

#: How long a client tries to reach a robot.
CONNECT_MS = 3000

#: A peer whose computer hangs or whose cable is pulled is gone after this; Zenoh's own default is 10 s.
LEASE_MS = 1000

#: A busy computer may hold the sending queue for longer than Zenoh's default of 1 ms; a tick is 20 ms.
WAIT_BEFORE_DROP_US = 10_000

#: A robot has a dozen keys; a message of it fits into this with room for keys and attachment.
MAX_MESSAGE_BYTES = 2 * MAX_PAYLOAD_BYTES


def check_link(link: Link) -> Endpoint:
    """Return a link's endpoint.

    Raises InputError for one that cannot be, and for one that would be open to strangers.
    """
    endpoint = Endpoint.parse(link.endpoint)
    if endpoint.encrypted:
        if link.credentials is None:
            raise InputError(
                f"{link.endpoint}: needs certificates; give --keys FOLDER, made with hexctl keys new"
            )
    elif not (endpoint.is_loopback or link.insecure):
        raise InputError(
            f"{link.endpoint}: goes beyond this computer without certificates; use tls/{endpoint.host}:"
            f"{endpoint.port} with --keys FOLDER (hexctl keys new), or say --insecure and mean it"
        )
    return endpoint


def open_session(link: Link, role: Role, keys: KeyMap) -> zenoh.Session:
    """Open a session; use it in a with statement, a process that does not close it never ends.

    A robot listens at the link's endpoint, everybody else connects to it. Raises InputError for a link that
    is not allowed, and RobotFaultError when there is no way to listen or to connect.
    """
    endpoint = check_link(link)
    settings = _settings(link, endpoint, role, keys)
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise RobotFaultError(_reason(link, endpoint, role, error)) from error


def _settings(link: Link, endpoint: Endpoint, role: Role, keys: KeyMap) -> dict[str, Any]:
    """Return Zenoh's settings of a session."""
    settings: dict[str, Any] = {
        # A robot is a peer, not a router: it talks with those who connect and passes nothing on between them.
        "mode": "peer" if role is Role.ROBOT else "client",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "listen/endpoints": [link.endpoint] if role is Role.ROBOT else [],
        "connect/endpoints": [] if role is Role.ROBOT else [link.endpoint],
        "connect/timeout_ms": CONNECT_MS,
        "connect/exit_on_failure": True,
        "transport/link/tx/lease": LEASE_MS,
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop": WAIT_BEFORE_DROP_US,
        "transport/link/rx/max_message_size": MAX_MESSAGE_BYTES,
    }
    if endpoint.encrypted and link.credentials is not None:
        settings |= _tls(link, role)
        if role is Role.ROBOT:
            settings["access_control"] = access_control(keys)
    return settings


def _tls(link: Link, role: Role) -> dict[str, Any]:
    """Return the settings of an encrypted link on which both ends show certificates."""
    assert link.credentials is not None  # noqa: S101  asked for before
    found = find_credentials(link.credentials, role)
    side = "listen" if role is Role.ROBOT else "connect"
    return {
        "transport/link/tls/root_ca_certificate": str(found.authority),
        f"transport/link/tls/{side}_certificate": str(found.certificate),
        f"transport/link/tls/{side}_private_key": str(found.key),
        "transport/link/tls/enable_mtls": True,
        "transport/link/tls/verify_name_on_connect": True,
        "transport/link/tls/close_link_on_expiration": True,
    }


def _reason(link: Link, endpoint: Endpoint, role: Role, error: zenoh.ZError) -> str:
    """Say what to check: Zenoh itself says little more than that there was a timeout."""
    if role is Role.ROBOT:
        why = str(error).partition(" at /")[0]
        return f"cannot listen at {link.endpoint} ({why}); is another robot served there already?"
    if endpoint.protocol != "quic" and not _somebody_listens(endpoint):
        return f"nothing listens at {link.endpoint}; is hexctl serve running there?"
    if endpoint.encrypted:
        return (
            f"{link.endpoint} does not accept this end; are --keys of the same authority on both ends, and "
            f"was the robot's certificate made for {endpoint.host}?"
        )
    return f"what listens at {link.endpoint} is no robot without certificates; does it want tls/ and --keys?"


def _somebody_listens(endpoint: Endpoint) -> bool:
    try:
        with socket.create_connection((endpoint.host, endpoint.port), timeout=1.0):
            return True
    except OSError:
        return False
