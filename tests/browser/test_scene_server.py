"""The server of a scene: for the page itself only, and undisturbed by clients that send nonsense."""

import http.client
import json
import socket
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import pytest
import viser
from websockets.exceptions import ConnectionClosed, InvalidStatus, WebSocketException
from websockets.sync.client import ClientConnection, connect
from websockets.sync.connection import Connection
from websockets.typing import Origin, Subprotocol

from hexctl.browser import scene_server
from hexctl.browser.scene_server import MOST_SOCKETS, SceneServer
from hexctl.errors import RobotFaultError
from hexctl.waiting import comes_true

VISER = Subprotocol(f"viser-v{viser.__version__}")


class Echo:
    """What the second socket has received."""

    def __init__(self) -> None:
        self.received: list[Any] = []

    async def talk(self, connection: Any) -> None:
        async for message in connection:
            self.received.append(message)


@pytest.fixture
def echo() -> Echo:
    return Echo()


@pytest.fixture
def server(echo: Echo) -> Iterator[SceneServer]:
    with SceneServer(0, title="test", controls="<b>ours</b>", talk=echo.talk) as running:
        yield running


def client(server: SceneServer, path: str, origin: str | None, **headers: str) -> ClientConnection:
    return connect(
        f"ws://127.0.0.1:{server.port}{path}",
        origin=None if origin is None else Origin(origin),
        subprotocols=[VISER] if path == "/" else None,
        additional_headers=headers,
        open_timeout=10,
        proxy=None,
    )


def get(server: SceneServer, path: str = "/", **headers: str) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10)
    connection.request("GET", path, headers=headers)
    return connection.getresponse()


def ends(connection: Connection) -> bool:
    """Whether the server closes a connection, after what it has sent."""
    try:
        while True:
            connection.recv(timeout=10)
    except ConnectionClosed:
        return True
    except TimeoutError:
        return False


FOREIGN = ("http://evil.example", "null", "http://127.0.0.1:1", "https://127.0.0.1:{port}", None)


@pytest.mark.parametrize("path", ["/", "/hexctl"])
@pytest.mark.parametrize("origin", FOREIGN)
def test_sockets_of_other_pages_are_refused(server: SceneServer, path: str, origin: str | None) -> None:
    given = None if origin is None else origin.format(port=server.port)
    with pytest.raises(InvalidStatus) as refused:
        client(server, path, given)
    assert refused.value.response.status_code == 403
    assert not server.viser.get_clients()


def test_a_page_of_another_origin_moves_no_control(server: SceneServer, echo: Echo) -> None:
    pressed: list[int] = []
    server.viser.gui.add_button("break").on_click(lambda _: pressed.append(1))
    for path in ("/", "/hexctl"):
        with pytest.raises(InvalidStatus):
            client(server, path, "http://evil.example")
    own = server.url.rstrip("/")
    with client(server, "/hexctl", own) as page:
        page.send("mine")
        assert comes_true(lambda: echo.received == ["mine"], 10)
    assert not pressed


def test_other_hosts_are_refused_as_of_dns_rebinding(server: SceneServer) -> None:
    assert get(server, Host=f"evil.example:{server.port}").status == 403
    with pytest.raises(InvalidStatus):
        client(server, "/", f"http://evil.example:{server.port}", Host=f"evil.example:{server.port}")
    answer = get(server, Host=f"localhost:{server.port}")
    assert answer.status == 200
    assert "frame-ancestors 'none'" in (answer.getheader("Content-Security-Policy") or "")


def test_it_listens_on_loopback_only(server: SceneServer) -> None:
    assert server._socket.getsockname()[0] == "127.0.0.1"
    assert server.viser.get_host() == "127.0.0.1"


def test_a_port_in_use_is_refused_and_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(RobotFaultError, match=str(port)):
            SceneServer(port, title="test")


def test_a_viser_that_starts_in_another_way_does_not_serve(monkeypatch: pytest.MonkeyPatch) -> None:
    from contextlib import nullcontext

    monkeypatch.setattr(scene_server, "_serving", lambda _: nullcontext())
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with pytest.raises(RobotFaultError, match="viser"):
        SceneServer(port, title="test")


def test_without_a_second_socket_there_is_none() -> None:
    with SceneServer(0, title="test") as server, pytest.raises(InvalidStatus) as refused:
        client(server, "/hexctl", server.url.rstrip("/"))
    assert refused.value.response.status_code == 404


def test_nonsense_ends_its_connection_only(server: SceneServer) -> None:
    own = server.url.rstrip("/")
    with client(server, "/", own) as good:
        assert good.recv(timeout=10)
        for junk in ("text", b"\xff" * 1000, json.dumps({"type": "no"}).encode(), b"x" * 100_000):
            with suppress(WebSocketException, OSError), client(server, "/", own) as bad:
                bad.send(junk)
                assert ends(bad)
        server.viser.scene.add_frame("/news")
        assert good.recv(timeout=10)
        assert good.ping().wait(10)


def test_a_client_at_full_speed_has_to_wait(server: SceneServer, echo: Echo) -> None:
    page = client(server, "/hexctl", server.url.rstrip("/"))
    page.socket.settimeout(0.2)
    began = time.monotonic()
    with suppress(OSError, WebSocketException):
        while time.monotonic() - began < 2.0:
            page.send("x" * 1000)
    took_s = time.monotonic() - began
    # A burst of one second's messages, then no more than the allowance.
    assert len(echo.received) <= scene_server.MESSAGES_S * (took_s + 2)
    page.close_socket()


def test_there_are_not_more_sockets_than_allowed(server: SceneServer) -> None:
    own = server.url.rstrip("/")
    open_ones = [client(server, "/hexctl", own) for _ in range(MOST_SOCKETS)]
    with pytest.raises(InvalidStatus) as refused:
        client(server, "/hexctl", own)
    assert refused.value.response.status_code == 503
    for one in open_ones:
        one.close()
