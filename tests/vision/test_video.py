"""Pictures over HTTP, frames of files, streams and cameras, and videos of what was seen."""

import http.client
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest

from hexctl.errors import InputError, RobotFaultError
from hexctl.vision.video import mjpeg, videos
from hexctl.vision.video.mjpeg import STREAM_PATH, MjpegServer
from hexctl.vision.video.videos import LiveVideo, VideoWriter, open_video
from hexctl.waiting import wait_for
from tests.server.processes import free_port
from tests.vision.scenes import plain


def port_of(server: MjpegServer) -> int:
    port = urlsplit(server.url).port
    assert port is not None
    return port


@contextmanager
def answered(
    server: MjpegServer, path: str = STREAM_PATH, host: str | None = None
) -> Iterator[http.client.HTTPResponse]:
    """The answer to a client without buffers."""
    connection = http.client.HTTPConnection(urlsplit(server.url).hostname or "", port_of(server), timeout=10)
    connection.request("GET", path, headers={} if host is None else {"Host": host})
    yield connection.getresponse()
    connection.close()


def got(server: MjpegServer, path: str, host: str | None = None) -> tuple[int, bytes]:
    """Status and content of an answer."""
    with answered(server, path, host) as answer:
        return answer.status, answer.read()


def test_a_client_that_takes_nothing_holds_nobody_up_and_then_gets_the_newest() -> None:
    numbered = [b"%06d" % number + bytes(200_000) for number in range(200)]
    with MjpegServer() as server, socket.socket() as slow:
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 10_000)
        slow.connect(("127.0.0.1", port_of(server)))
        slow.sendall(b"GET /stream.mjpg HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        wait_for(lambda: server.clients, 10, "the client was never let in")
        for picture in numbered:
            server.publish(picture)
        slow.settimeout(10)
        came = b""
        while b"000199" not in came:
            came += slow.recv(100_000)
        assert came.count(b"Content-Length") < 5


def test_a_page_is_there_for_this_computer() -> None:
    with MjpegServer() as server:
        status, page = got(server, "/")
        assert status == 200
        assert b"/stream.mjpg" in page
        assert got(server, "/elsewhere")[0] == 404
        assert got(server, "/", host="attacker.example:80")[0] == 403
        assert got(server, "/", host="localhost:80")[0] == 200
        with pytest.raises(RobotFaultError, match=str(port_of(server))):
            MjpegServer(port_of(server))


def test_clients_beyond_the_limit_are_refused_and_the_end_ends_all_streams(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(mjpeg, "MOST_CLIENTS", 1)
    with MjpegServer() as server:
        server.publish(b"picture")
        with answered(server) as first, answered(server) as second:
            assert first.read(2) == b"--"
            assert (second.status, second.reason) == (503, "too many clients")
            server.close()
            assert first.read().endswith(b"picture\r\n")
    with pytest.raises(ConnectionRefusedError):
        got(server, "/")


@pytest.mark.parametrize("host", ["localhost", "::1"])
def test_it_listens_on_other_names_of_this_computer(host: str) -> None:
    try:
        server = MjpegServer(host=host)
    except RobotFaultError:
        pytest.skip(f"this computer has no {host}")
    with server:
        assert urlsplit(server.url).hostname == host
        assert got(server, "/")[0] == 200
        assert got(server, "/", host="other.example:80")[0] == 403


@pytest.mark.parametrize("name", ["seen.avi", "seen.mp4"])
def test_each_frame_of_a_file_comes_with_its_time(tmp_path: Path, name: str) -> None:
    with VideoWriter(tmp_path / name, fps=25) as writer:
        for number in range(5):
            writer.write(plain(50 * number), number / 25)
    with open_video(str(tmp_path / name)) as source:
        frames = list(source)
        assert source.ended
        assert source.read() is None
    assert [frame.at_s for frame in frames] == pytest.approx([0, 0.04, 0.08, 0.12, 0.16])
    assert [frame.gray().mean() for frame in frames] == pytest.approx([0, 50, 100, 150, 200], abs=4)
    assert not source.live


class Camera:
    """What OpenCV opens, with frames that the test gives it.

    Attributes:
        lost: whether it gives no more.
    """

    def __init__(self, brightnesses: list[int]) -> None:
        self._left = brightnesses
        self.lost = False

    def grab(self) -> bool:
        return bool(wait_for(lambda: self._left or self.lost, 10, "never closed")) and not self.lost

    def retrieve(self) -> tuple[bool, np.ndarray]:
        return True, plain(self._left.pop(0))

    def release(self) -> None:
        self.lost = True


def test_of_a_camera_only_the_newest_frame_is_kept() -> None:
    camera = Camera([10, 20, 30])
    with LiveVideo("0", lambda: camera, lambda _: None) as source:
        wait_for(lambda: source.dropped == 2, 10, "three frames never came")
        frame = source.read()
        assert frame is not None
        assert frame.picture.mean() == 30
        assert source.read(0.01) is None
        camera.lost = True
    assert source.read() is None


def test_a_camera_that_is_lost_is_told_and_found_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(videos, "REOPEN_S", 0.01)
    first, second = Camera([10]), Camera([20])
    openings: list[Camera | None] = [first, None, second]
    said: list[str] = []

    def opened() -> Camera:
        camera = openings.pop(0)
        if camera is None:
            raise RobotFaultError("not yet")
        return camera

    with LiveVideo("0", opened, said.append) as source:
        frame = source.read(10)
        assert frame is not None
        first.lost = True
        again = source.read(10)
        assert again is not None
        assert again.picture.mean() == 20
        second.lost = True
    assert len(said) == 2, "lost, and there again"


@pytest.mark.parametrize(
    ("source", "error"),
    [
        ("ftp://camera", InputError),
        ("no.mp4", InputError),
        ("text.mp4", InputError),
        ("77", RobotFaultError),
        ("http://127.0.0.1:{port}/", RobotFaultError),
    ],
)
def test_what_is_no_camera_is_refused_in_one_line(
    source: str, error: type[Exception], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("text.mp4").write_text("no video")
    with pytest.raises(error) as raised:
        open_video(source.format(port=free_port()))
    assert "\n" not in str(raised.value)


def written(path: Path, times_s: list[float], fps: float = 10.0) -> list[int]:
    """Brightness of each frame, over ten, of a video of one picture after another, each brighter by ten."""
    with VideoWriter(path, fps) as writer:
        for number, at_s in enumerate(times_s):
            writer.write(plain(10 * number), at_s)
    with open_video(str(path)) as source:
        return [round(frame.picture.mean() / 10) for frame in source]


def test_a_picture_lasts_until_the_next_one_came(tmp_path: Path) -> None:
    assert written(tmp_path / "seen.avi", [7.0, 7.3, 7.4]) == [0, 0, 0, 1, 2]
    assert written(tmp_path / "gap.avi", [0.0, 0.1, 60.0, 60.1]) == [0, 1, 2, 3], "a long gap is left out"
    faster = written(tmp_path / "fast.avi", list(np.arange(0, 0.7, 0.03)))
    assert len(faster) == len(set(faster)) == 8, "some are left out"
    with pytest.raises(InputError):
        VideoWriter(tmp_path / "seen.gif")
