"""Zenoh sessions of robots, controllers and viewers: closed by default, access per certificate."""

import json
import os
from typing import TYPE_CHECKING, Any

import zenoh

from hexctl.errors import InputError, RobotFaultError, argument
from hexctl.wire import MAX_PAYLOAD_BYTES
from hexctl.wire.connection_diagnosis import why_not_connected, why_not_listening
from hexctl.wire.links import ROOT, Endpoint, KeyMap, Link, Role

if TYPE_CHECKING:
    from hexctl.wire.certificates import Credentials

#: Kinds of messages that a robot publishes, subscribes to, and answers.
PUBLISHED = ("joint_states", "odom", "battery", "status", "imu", "truth")
SUBSCRIBED = ("command", "pose")
QUERYABLE = ("describe", "lease", "estop", "failure")

#: Queries to every robot on a link, without its name.
QUERIED_BY_WILDCARD = ("describe", "estop", "failure")


def access_control(keys: KeyMap, *, certified: bool) -> dict[str, Any]:
    """Section `access_control` of a robot's Zenoh configuration.

    Controllers and viewers receive what the robot publishes and may query its description. Only controllers
    may command, set the pose, and query lease and stop. Only the robot may publish or answer under its keys.
    Without certificates every client is a controller: a subject without properties matches any peer.
    """
    viewing = [
        _rule("publish", "egress", ["put"], _keys(keys, PUBLISHED)),
        _rule("be subscribed to", "ingress", ["declare_subscriber"], _keys(keys, PUBLISHED)),
        _rule("answer", "egress", ["declare_queryable", "reply"], _keys(keys, QUERYABLE)),
        _rule("subscribe", "egress", ["declare_subscriber"], _keys(keys, SUBSCRIBED)),
        _rule("be described", "ingress", ["query"], _queried(keys, ("describe",))),
    ]
    commanding = [
        _rule("be commanded", "ingress", ["put"], _keys(keys, SUBSCRIBED)),
        _rule("be queried", "ingress", ["query"], _queried(keys, QUERYABLE)),
    ]
    allowed = {Role.CONTROLLER: viewing + commanding}
    if certified:
        allowed[Role.VIEWER] = viewing
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": viewing + commanding,
        "subjects": [
            {"id": role.value, **({"cert_common_names": [role.value]} if certified else {})}
            for role in allowed
        ],
        "policies": [
            {"rules": [rule["id"] for rule in rules], "subjects": [role.value]}
            for role, rules in allowed.items()
        ],
    }


def _rule(name: str, flow: str, messages: list[str], keys: list[str]) -> dict[str, Any]:
    return {"id": name, "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": keys}


def _keys(keys: KeyMap, kinds: tuple[str, ...]) -> list[str]:
    return [getattr(keys, kind) for kind in kinds]


def _queried(keys: KeyMap, kinds: tuple[str, ...]) -> list[str]:
    return _keys(keys, kinds) + [f"{ROOT}/*/{kind}" for kind in kinds if kind in QUERIED_BY_WILDCARD]


#: How long a client tries to reach a robot.
CONNECT_MS = 3000

#: Longest pause between two attempts to connect.
RETRY_MS = 1000

#: A silent peer is disconnected after this; Zenoh's default is 10 s.
LEASE_MS = 1000

#: A busy computer may block the sending queue for longer than Zenoh's default of 1 ms; a tick is 20 ms.
WAIT_BEFORE_DROP_US = 10_000

#: Threads of a robot's Zenoh session for receiving, sending, routing and accepting. Closing the connection
#: of a viewer that reads nothing may block one for 10 s; if all are blocked, no controller is heard.
#: `hexctl.server.transport.end_lingering` keeps most from that.
ROBOT_THREADS = {"rx": 32, "tx": 16, "net": 8, "acc": 16}

#: Configures Zenoh's threads when a process opens its first session.
RUNTIME_VARIABLE = "ZENOH_RUNTIME"

#: Longest transport message: a payload with room for keys and attachment.
MAX_MESSAGE_BYTES = 2 * MAX_PAYLOAD_BYTES


def check_link(link: Link, role: Role) -> Endpoint:
    """Endpoint of a link; raises InputError if it is malformed or open to any client on the network."""
    endpoint = Endpoint.parse(link.endpoint)
    if endpoint.encrypted and link.credentials is None:
        raise InputError(
            f"{endpoint}: needs certificates; give {argument('credentials')} FOLDER, made with hexctl keys "
            "new"
        )
    if not endpoint.encrypted and link.credentials is not None:
        raise InputError(
            f"{endpoint}: got {argument('credentials')} {link.credentials}, and tcp knows no certificates; "
            f"use tls/{endpoint.place}"
        )
    if not (endpoint.encrypted or endpoint.is_loopback or link.insecure):
        raise InputError(
            f"{endpoint}: goes beyond this computer without certificates; use tls/{endpoint.place} "
            f"with {argument('credentials')} FOLDER (hexctl keys new), or give {argument('insecure')} "
            "deliberately"
        )
    if endpoint.is_everywhere and role is not Role.ROBOT:
        raise InputError(
            f"{endpoint}: stands for all addresses, where a robot listens; allowed here: the robot's own, "
            f"on this computer {endpoint.protocol}/127.0.0.1:{endpoint.port}"
        )
    return endpoint


def open_session(link: Link, role: Role, keys: KeyMap) -> zenoh.Session:
    """Open a session; use it in a with statement, because an unclosed one keeps the process alive.

    A robot listens at the link's endpoint, every other role connects to it. Raises InputError for a link that
    is not allowed, and RobotFaultError with the reason if listening or connecting fails.
    """
    endpoint = check_link(link, role)
    found = _find_credentials(link, role)
    if role is Role.ROBOT:
        threads = ", ".join(f"{name}: (worker_threads: {count})" for name, count in ROBOT_THREADS.items())
        os.environ.setdefault(RUNTIME_VARIABLE, f"({threads})")
    try:
        return open_configured(_settings(endpoint, role, keys, found))
    except zenoh.ZError as error:
        listens = role is Role.ROBOT
        reason = why_not_listening(endpoint) if listens else why_not_connected(endpoint, found)
        raise RobotFaultError(reason) from error


def open_configured(settings: dict[str, Any]) -> zenoh.Session:
    """Open a session with settings of Zenoh, by their paths; raises zenoh.ZError."""
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def _find_credentials(link: Link, role: Role) -> "Credentials | None":
    """Without certificates the cryptography library is not loaded."""
    if link.credentials is None:
        return None
    from hexctl.wire.certificates import find_credentials

    return find_credentials(link.credentials, role)


def _settings(endpoint: Endpoint, role: Role, keys: KeyMap, found: "Credentials | None") -> dict[str, Any]:
    listens = role is Role.ROBOT
    settings: dict[str, Any] = {
        # A peer keeps no map of the network that others could write into, unlike a router. It would still
        # forward messages between clients; access control forbids that.
        "mode": "peer" if listens else "client",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "listen/endpoints": [str(endpoint)] if listens else [],
        "connect/endpoints": [] if listens else [str(endpoint)],
        "connect/timeout_ms": CONNECT_MS,
        "connect/exit_on_failure": True,
        "connect/retry": {"period_init_ms": 100, "period_max_ms": RETRY_MS, "period_increase_factor": 2.0},
        # A client that connects and sends nothing is dropped after this.
        "transport/unicast/accept_timeout": CONNECT_MS,
        "transport/link/tx/lease": LEASE_MS,
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop": WAIT_BEFORE_DROP_US,
        "transport/link/rx/max_message_size": MAX_MESSAGE_BYTES,
        # Long messages of this computer would otherwise pass through shared memory, past the limit above.
        "transport/shared_memory/enabled": False,
    }
    if found is not None:
        settings |= _tls(found, "listen" if listens else "connect")
    if listens:
        settings["access_control"] = access_control(keys, certified=found is not None)
    return settings


def _tls(found: "Credentials", side: str) -> dict[str, Any]:
    return {
        "transport/link/tls/root_ca_certificate": str(found.authority),
        f"transport/link/tls/{side}_certificate": str(found.certificate),
        f"transport/link/tls/{side}_private_key": str(found.key),
        "transport/link/tls/enable_mtls": True,
        "transport/link/tls/verify_name_on_connect": True,
        "transport/link/tls/close_link_on_expiration": True,
    }
