"""Zenoh sessions of robots, controllers and viewers: closed by default, access per certificate."""

import errno
import json
import os
import socket
import ssl
from typing import TYPE_CHECKING, Any

import zenoh

from hexctl.errors import InputError, RobotFaultError
from hexctl.wire import MAX_PAYLOAD_BYTES
from hexctl.wire.links import ROOT, Endpoint, KeyMap, Link, Role

if TYPE_CHECKING:
    from hexctl.wire.certificates import Credentials

#: What a robot publishes, what it is told, what it answers.
SAID = ("joint_states", "odom", "battery", "status")
HEARD = ("command", "pose")
ANSWERED = ("describe", "lease", "estop")

#: Asked of whatever robot is on a link: its name need not be known.
ASKED_OF_ANY = ("describe", "estop")


def access_control(keys: KeyMap, *, certified: bool) -> dict[str, Any]:
    """Return the `access_control` section of a robot's Zenoh configuration.

    Without certificates everybody is a controller: a subject without properties is anybody.

    Controllers and viewers get what the robot says and may ask who it is; only controllers may command, say
    where it is, and ask for lease and stop. Nobody but the robot may say anything in its name, or answer.
    """
    looking = [
        _rule("says", "egress", ["put"], _keys(keys, SAID)),
        _rule("is listened to", "ingress", ["declare_subscriber"], _keys(keys, SAID)),
        _rule("offers answers", "egress", ["declare_queryable", "reply"], _keys(keys, ANSWERED)),
        _rule("wants to hear", "egress", ["declare_subscriber"], _keys(keys, HEARD)),
        _rule("is asked who it is", "ingress", ["query"], _asked(keys, ("describe",))),
    ]
    commanding = [
        _rule("is commanded", "ingress", ["put"], _keys(keys, HEARD)),
        _rule("is asked", "ingress", ["query"], _asked(keys, ANSWERED)),
    ]
    allowed = {Role.CONTROLLER: looking + commanding}
    if certified:
        allowed[Role.VIEWER] = looking
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": looking + commanding,
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


def _asked(keys: KeyMap, kinds: tuple[str, ...]) -> list[str]:
    """Return the keys of a robot's answers, and the expressions that ask any robot."""
    return _keys(keys, kinds) + [f"{ROOT}/*/{kind}" for kind in kinds if kind in ASKED_OF_ANY]


#: How long the other end may take to show what it is.
PATIENCE_S = 1.0


def why_not_listening(endpoint: Endpoint) -> str:
    """Return why a robot cannot listen at an endpoint."""
    kind = socket.SOCK_DGRAM if endpoint.protocol == "quic" else socket.SOCK_STREAM
    try:
        family, _, _, _, address = socket.getaddrinfo(endpoint.host, endpoint.port, type=kind)[0]
        with socket.socket(family, kind) as trial:
            if kind == socket.SOCK_STREAM:  # as Zenoh does; a connection that has just ended is no listener
                trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            trial.bind(address)
    except OSError as error:
        return f"cannot listen at {endpoint}: {_bind_problem(endpoint, error)}"
    return f"cannot listen at {endpoint}: the port is free now, somebody else has just had it; try again"


def why_not_connected(endpoint: Endpoint, credentials: "Credentials | None") -> str:
    """Return why a client does not get through to an endpoint, and what to check."""
    if endpoint.protocol == "quic":  # over UDP nobody says that nobody is there
        return (
            f"no robot lets this end in at {endpoint}; is hexctl serve running there, are --keys of the same "
            f"authority on both ends, and was the robot's certificate made for {endpoint.host}?"
        )
    try:
        with socket.create_connection((endpoint.host, endpoint.port), timeout=PATIENCE_S) as link:
            return _why_refused(endpoint, credentials, link)
    except socket.gaierror:
        return f"{endpoint}: no computer called {endpoint.host} is known here; try its address"
    except ConnectionRefusedError:
        return f"nothing listens at {endpoint}; is hexctl serve running there?"
    except OSError as error:
        return f"nothing answers at {endpoint} ({_cause(error)}); is it on, and on this network?"


def _why_refused(endpoint: Endpoint, credentials: "Credentials | None", link: socket.socket) -> str:
    """Say what is wrong although something listens."""
    if credentials is None:
        return f"what listens at {endpoint} is no robot without certificates; does it want tls/ and --keys?"
    try:
        context = ssl.create_default_context(cafile=credentials.authority)
        context.load_cert_chain(credentials.certificate, credentials.key)
        with context.wrap_socket(link, server_hostname=endpoint.host) as secured:
            secured.recv(1)  # a refusal of our certificate comes only now
    except ssl.SSLCertVerificationError as error:
        return (
            f"the robot's certificate at {endpoint} is not good here ({error.verify_message.rstrip('.')}); "
            f"are --keys of the same authority on both ends, and was it made for {endpoint.host}? "
            "See hexctl keys show"
        )
    except ssl.SSLError as error:
        return (
            f"the robot at {endpoint} refuses this end's certificate ({_alert(error)}); are --keys of the "
            "same authority on both ends? See hexctl keys show"
        )
    except OSError:
        pass  # it waits for us to speak: either it has let us in, or it does not speak TLS
    return f"something at {endpoint} accepts connections and says nothing; is it hexctl serve with --keys?"


def _bind_problem(endpoint: Endpoint, error: OSError) -> str:
    if error.errno == errno.EADDRINUSE:
        return "already in use; is another robot served there? Give each a port of its own"
    if error.errno == errno.EADDRNOTAVAIL or isinstance(error, socket.gaierror):
        return f"{endpoint.host} is none of this computer's addresses; 0.0.0.0 stands for all of them"
    return _cause(error)


def _cause(error: OSError) -> str:
    """Return what the system says of an error, without its number."""
    return os.strerror(error.errno).lower() if error.errno else str(error)


def _alert(error: ssl.SSLError) -> str:
    """Return the other end's alert in words, such as `unknown ca`."""
    return (error.reason or str(error)).partition("ALERT_")[2].replace("_", " ").lower() or str(error.reason)


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
    found = _find_credentials(link, role)
    config = zenoh.Config()
    for key, value in _settings(endpoint, role, keys, found).items():
        config.insert_json5(key, json.dumps(value))
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        listens = role is Role.ROBOT
        reason = why_not_listening(endpoint) if listens else why_not_connected(endpoint, found)
        raise RobotFaultError(reason) from error


def _find_credentials(link: Link, role: Role) -> "Credentials | None":
    """Credentials of a link's folder; without certificates the cryptography library is not loaded."""
    if link.credentials is None:
        return None
    from hexctl.wire.certificates import find_credentials

    return find_credentials(link.credentials, role)


def _settings(endpoint: Endpoint, role: Role, keys: KeyMap, found: "Credentials | None") -> dict[str, Any]:
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


def _tls(found: "Credentials", side: str) -> dict[str, Any]:
    """Return the settings of an encrypted link on which both ends show certificates."""
    return {
        "transport/link/tls/root_ca_certificate": str(found.authority),
        f"transport/link/tls/{side}_certificate": str(found.certificate),
        f"transport/link/tls/{side}_private_key": str(found.key),
        "transport/link/tls/enable_mtls": True,
        "transport/link/tls/verify_name_on_connect": True,
        "transport/link/tls/close_link_on_expiration": True,
    }
