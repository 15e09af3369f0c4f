"""Why a link does not open: Zenoh itself says little more than that there was a timeout."""

import errno
import os
import socket
import ssl

from hexctl.wire.credentials import Credentials
from hexctl.wire.endpoint import Endpoint

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


def why_not_connected(endpoint: Endpoint, credentials: Credentials | None) -> str:
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


def _why_refused(endpoint: Endpoint, credentials: Credentials | None, link: socket.socket) -> str:
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
