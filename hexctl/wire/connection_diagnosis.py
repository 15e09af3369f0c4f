"""Diagnoses why an endpoint cannot be reached; without Zenoh, because a stop must not wait for it."""

import errno
import os
import socket
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Self

from hexctl.errors import argument
from hexctl.wire.links import Endpoint

if TYPE_CHECKING:
    import ssl

    from hexctl.wire.certificates import Credentials

#: How long a diagnosis waits for the other end.
PROBE_TIMEOUT_S = 1.0

#: The port is probed only if no robot has answered by then.
ANSWERS_WITHIN_S = 0.25


def is_refused(endpoint: Endpoint) -> bool:
    """Whether nothing listens at an endpoint, within `PROBE_TIMEOUT_S`; False if unknown, as with quic."""
    if endpoint.protocol == "quic":  # UDP does not report that nothing listens
        return False
    try:
        with socket.create_connection((endpoint.host, endpoint.port), timeout=PROBE_TIMEOUT_S):
            return False
    except ConnectionRefusedError:
        return True
    except (OSError, UnicodeError):  # the second of a name that no host can have
        return False


def why_not_listening(endpoint: Endpoint) -> str:
    """Reason why a robot cannot listen at an endpoint."""
    kind = socket.SOCK_DGRAM if endpoint.protocol == "quic" else socket.SOCK_STREAM
    try:
        family, _, _, _, address = socket.getaddrinfo(endpoint.host, endpoint.port, type=kind)[0]
        with socket.socket(family, kind) as trial:
            if kind == socket.SOCK_STREAM:  # as Zenoh does; closed connections do not block it
                trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            trial.bind(address)
    except OSError as error:
        return f"cannot listen at {endpoint}: {_bind_problem(endpoint, error)}"
    return f"cannot listen at {endpoint}: the port is free now, another process has just used it; try again"


def why_not_connected(endpoint: Endpoint, credentials: "Credentials | None") -> str:
    """Reason why a client cannot connect to an endpoint, and a next step."""
    if endpoint.protocol == "quic":  # UDP does not report that nothing listens
        return (
            f"no robot lets this end in at {endpoint}; is hexctl serve running there, are "
            f"{argument('credentials')} of the same "
            f"authority on both ends, and was the robot's certificate made for {endpoint.host}?"
        )
    try:
        with socket.create_connection((endpoint.host, endpoint.port), timeout=PROBE_TIMEOUT_S) as link:
            return _why_refused(endpoint, credentials, link)
    except socket.gaierror:
        return f"{endpoint}: no computer called {endpoint.host} is known here; try its address"
    except ConnectionRefusedError:
        return f"nothing listens at {endpoint}; is hexctl serve running there?"
    except OSError as error:
        return f"nothing answers at {endpoint} ({_cause(error)}); is it on, and on this network?"


def _why_refused(endpoint: Endpoint, credentials: "Credentials | None", link: socket.socket) -> str:
    import ssl

    if credentials is None:
        return _why_refused_openly(endpoint, link)
    try:
        context = ssl.create_default_context(cafile=credentials.authority)
        context.load_cert_chain(credentials.certificate, credentials.key)
        with context.wrap_socket(link, server_hostname=endpoint.host) as secured:
            secured.recv(1)  # a refusal of this end's certificate arrives only now
    except ssl.SSLCertVerificationError as error:
        return (
            f"the robot's certificate at {endpoint} is not good here ({error.verify_message.rstrip('.')}); "
            f"are {argument('credentials')} of the same authority on both ends, and was it made for "
            f"{endpoint.host}? "
            "See hexctl keys show"
        )
    except ssl.SSLError as error:
        return (
            f"the robot at {endpoint} refuses this end's certificate ({_alert(error)}); are "
            f"{argument('credentials')} of the "
            "same authority on both ends? See hexctl keys show"
        )
    except OSError:
        pass  # it waits for data: it either accepted the connection, or does not speak TLS
    keys = argument("credentials")
    return f"something at {endpoint} accepts connections but sends nothing; is it hexctl serve with {keys}?"


def _why_refused_openly(endpoint: Endpoint, link: socket.socket) -> str:
    """Without certificates; a robot that hangs is silent."""
    import ssl

    keys = argument("credentials")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    try:
        with context.wrap_socket(link):
            pass
    except TimeoutError:
        return f"no answer from {endpoint}: it accepts connections but sends nothing; does hexctl serve hang?"
    except OSError:
        pass  # it has answered or disconnected
    return f"what listens at {endpoint} is no robot without certificates; does it want tls/ and {keys}?"


def _bind_problem(endpoint: Endpoint, error: OSError) -> str:
    if error.errno == errno.EADDRINUSE:
        return "already in use; by another robot or a ROS router? --listen gives each its own address"
    if error.errno == errno.EADDRNOTAVAIL or isinstance(error, socket.gaierror):
        return f"{endpoint.host} is none of this computer's addresses; 0.0.0.0 stands for all of them"
    return _cause(error)


def _cause(error: OSError) -> str:
    return os.strerror(error.errno).lower() if error.errno else str(error)


def _alert(error: "ssl.SSLError") -> str:
    return (error.reason or str(error)).partition("ALERT_")[2].replace("_", " ").lower() or str(error.reason)


class RefusalWatch:
    """Reports once, on its own thread, that nothing listens at an endpoint; a context manager.

    Nothing is reported if `answered` returns True. Raises InputError for an invalid endpoint.
    """

    def __init__(
        self, endpoint: str, tell: Callable[[str], None], *, answered: Callable[[], bool] = lambda: False
    ) -> None:
        self._endpoint, self._tell, self._answered = Endpoint.parse(endpoint), tell, answered
        self._over = threading.Event()
        self._telling = threading.Lock()

    def __enter__(self) -> Self:
        """Start the probe; returns immediately."""
        threading.Thread(target=self._look, name="refusal", daemon=True).start()
        return self

    def __exit__(self, *error: object) -> None:
        with self._telling:  # no report from here on
            self._over.set()

    def _look(self) -> None:
        if self._over.wait(ANSWERS_WITHIN_S) or self._answered() or not is_refused(self._endpoint):
            return
        with self._telling:
            if not self._over.is_set() and not self._answered():
                self._tell(f"nothing listens at {self._endpoint}")
