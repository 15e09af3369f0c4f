"""Pictures over HTTP."""

import http.client
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from urllib.parse import urlsplit

import pytest

from hexctl.errors import RobotFaultError
from hexctl.vision.video import mjpeg
from hexctl.vision.video.mjpeg import PICTURE_PATH, STREAM_PATH, MjpegServer
from hexctl.vision.video.video_source import open_video
from hexctl.waiting import wait_for
from tests.vision.feeding import feeding, wait_for_brightness

pytestmark = pytest.mark.realtime


def port_of(server: MjpegServer) -> int:
    port = urlsplit(server.url).port
    assert port is not None
    return port


def got(server: MjpegServer, path: str, host: str | None = None) -> tuple[int, bytes]:
    """Status and content of an answer."""
    connection = http.client.HTTPConnection(urlsplit(server.url).hostname or "", port_of(server), timeout=10)
    connection.request("GET", path, headers={} if host is None else {"Host": host})
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, content


def test_several_clients_see_the_newest_picture() -> None:
    with feeding(50) as feed:
        with ExitStack() as clients:
            sources = [clients.enter_context(open_video(feed.server.url)) for _ in range(3)]
            for source in sources:
                wait_for_brightness(source, 50)
            assert feed.server.clients == 3
            feed.brightness = 150
            for source in sources:
                wait_for_brightness(source, 150)
        wait_for(lambda: feed.server.clients == 0, 10, "a client that has gone is still counted")


def test_a_client_that_takes_nothing_holds_nobody_up_and_then_gets_the_newest() -> None:
    numbered = [b"%06d" % number + bytes(200_000) for number in range(200)]
    with MjpegServer() as server, socket.socket() as slow:
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 10_000)
        slow.connect(("127.0.0.1", port_of(server)))
        slow.sendall(b"GET /stream.mjpg HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        wait_for(lambda: server.clients, 10, "the client was never let in")
        for picture in numbered:
            server.publish(picture)
        assert got(server, PICTURE_PATH)[1] == numbered[-1]
        slow.settimeout(10)
        came = b""
        while b"000199" not in came:
            came += slow.recv(100_000)
        assert came.count(b"Content-Length") < 5


def test_a_page_and_a_single_picture_are_there_too() -> None:
    with MjpegServer() as server:
        assert got(server, PICTURE_PATH)[0] == 503
        server.publish(b"picture")
        assert got(server, PICTURE_PATH) == (200, b"picture")
        status, page = got(server, "/")
        assert status == 200
        assert b"/stream.mjpg" in page
        assert got(server, "/elsewhere")[0] == 404


def test_who_asks_for_another_computer_is_refused() -> None:
    with MjpegServer() as server:
        server.publish(b"picture")
        assert got(server, PICTURE_PATH, host="attacker.example:80")[0] == 403
        assert got(server, PICTURE_PATH, host="localhost:80")[0] == 200


@contextmanager
def streaming(server: MjpegServer) -> Iterator[http.client.HTTPResponse]:
    """A stream that a client without buffers reads."""
    connection = http.client.HTTPConnection("127.0.0.1", port_of(server), timeout=10)
    connection.request("GET", STREAM_PATH)
    yield connection.getresponse()
    connection.close()


def test_more_clients_than_allowed_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mjpeg, "MOST_CLIENTS", 1)
    with MjpegServer() as server:
        server.publish(b"picture")
        with streaming(server) as first, streaming(server) as second:
            assert first.read(2) == b"--"
            assert (second.status, second.reason) == (503, "too many clients")


def test_its_end_ends_all_streams() -> None:
    with MjpegServer() as server:
        server.publish(b"picture")
        with streaming(server) as stream:
            assert stream.read(2) == b"--"
            server.close()
            assert stream.read().endswith(b"picture\r\n")
    with pytest.raises(ConnectionRefusedError):
        got(server, "/")


def test_a_port_in_use_is_named() -> None:
    with MjpegServer() as server, pytest.raises(RobotFaultError, match=f"got {port_of(server)}, which"):
        MjpegServer(port_of(server))


@pytest.mark.parametrize("host", ["localhost", "::1"])
def test_it_listens_on_other_names_of_this_computer(host: str) -> None:
    try:
        server = MjpegServer(host=host)
    except RobotFaultError:
        pytest.skip(f"this computer has no {host}")
    with server:
        server.publish(b"picture")
        assert urlsplit(server.url).hostname == host
        assert got(server, PICTURE_PATH) == (200, b"picture")
        assert got(server, PICTURE_PATH, host="other.example:80")[0] == 403
