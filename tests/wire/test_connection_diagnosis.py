"""That nothing listens at an endpoint is known before a session has given up."""

import socket
import threading

import pytest

from hexctl.errors import InputError
from hexctl.wire.connection_diagnosis import RefusalWatch, is_refused
from hexctl.wire.links import Endpoint
from tests.server.processes import free_port

WAIT_S = 60.0


class Told:
    """Takes what a watch tells."""

    def __init__(self) -> None:
        self.texts: list[str] = []
        self.came = threading.Event()

    def __call__(self, text: str) -> None:
        self.texts.append(text)
        self.came.set()


@pytest.mark.parametrize("protocol", ["tcp", "tls"])
@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_a_closed_port_refuses_and_an_open_one_does_not(protocol: str, host: str) -> None:
    assert is_refused(Endpoint(protocol, host, free_port()))
    with socket.create_server(("127.0.0.1", 0)) as listening:
        assert not is_refused(Endpoint(protocol, host, int(listening.getsockname()[1])))


def test_what_cannot_be_known_is_no_refusal() -> None:
    assert not is_refused(Endpoint("quic", "127.0.0.1", free_port()))
    assert not is_refused(Endpoint("tcp", f"{'a' * 70}.local", free_port()))


def test_a_refusal_is_told_once_while_the_block_runs() -> None:
    told, port = Told(), free_port()
    with RefusalWatch(f"tcp/127.0.0.1:{port}", told):
        assert told.came.wait(WAIT_S)
    assert told.texts == [f"nothing listens at tcp/127.0.0.1:{port}"]


def test_nothing_is_told_of_a_robot_that_has_answered_otherwise() -> None:
    asked = threading.Event()
    told = Told()

    def answered() -> bool:
        asked.set()
        return True

    with RefusalWatch(f"tcp/127.0.0.1:{free_port()}", told, answered=answered):
        assert asked.wait(WAIT_S)
    assert told.texts == []


def test_an_endpoint_that_is_none_is_refused_at_once() -> None:
    with pytest.raises(InputError, match="endpoint: got 'tcp/nowhere'"):
        RefusalWatch("tcp/nowhere", Told())
