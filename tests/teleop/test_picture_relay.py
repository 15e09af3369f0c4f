"""Pictures of a camera for the page: streams, single pictures, and cameras that send something else."""

import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from hexctl.errors import InputError
from hexctl.teleop import picture_relay
from hexctl.teleop.picture_relay import PictureRelay
from hexctl.waiting import wait_for

pytestmark = pytest.mark.realtime

Handler = Callable[[socket.socket], None]


def jpeg(number: int = 0, width: int = 64, height: int = 48) -> bytes:
    """What looks like a JPEG from outside: a header with its size, and any bytes."""
    head = b"\xff\xd8\xff\xe0\x00\x04ab" + b"\xff\xc0\x00\x11\x08" + struct.pack(">HH", height, width)
    return head + b"\xff\xd8\r\n\r\n--" + bytes([number]) * 3000 + b"\xff\xd9"


def part(picture: bytes, *, length: bool) -> bytes:
    told = f"Content-Length: {len(picture)}\r\n" if length else ""
    return b"--frame\r\nContent-Type: image/jpeg\r\n" + told.encode() + b"\r\n" + picture + b"\r\n"


def answer(kind: str, body: bytes = b"", status: str = "200 OK") -> bytes:
    return f"HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nConnection: close\r\n\r\n".encode() + body


STREAM = answer("multipart/x-mixed-replace; boundary=frame")


@contextmanager
def camera(handler: Handler) -> Iterator[str]:
    """A camera that answers each connection with a function, on a free port."""
    listener = socket.create_server(("127.0.0.1", 0))
    ended = threading.Event()

    def work() -> None:
        while not ended.is_set():
            try:
                connection, _ = listener.accept()
            except OSError:
                return
            with connection:
                connection.recv(4096)
                try:
                    handler(connection)
                except OSError:
                    continue

    threading.Thread(target=work, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{listener.getsockname()[1]}/picture"
    finally:
        ended.set()
        listener.close()


@contextmanager
def relay(handler: Handler) -> Iterator[PictureRelay]:
    with camera(handler) as url, PictureRelay(url) as made:
        yield made


def trouble(handler: Handler) -> str:
    with relay(handler) as made:
        wait_for(lambda: made.trouble, 20.0, "no trouble was told")
        assert made.newest is None
        return str(made.trouble)


@pytest.mark.parametrize("length", [True, False])
def test_a_stream_gives_one_picture_after_another(length: bool) -> None:
    def send(connection: socket.socket) -> None:
        connection.sendall(STREAM + b"\r\n")
        for number in range(100):
            connection.sendall(part(jpeg(number), length=length))
            time.sleep(0.03)

    seen: dict[int, bytes] = {}
    with relay(send) as made:

        def several() -> bool:
            if made.newest is not None:
                seen[made.newest.number] = made.newest.jpeg
            return len(seen) >= 4

        wait_for(several, 20.0, "too few pictures")
    assert set(seen.values()) <= {jpeg(number) for number in range(100)}
    assert len(set(seen.values())) == len(seen)
    assert list(seen) == sorted(seen)


@pytest.mark.parametrize(
    ("sent", "told"),
    [
        (answer("image/jpeg", b"<html>"), "no JPEG"),
        (answer("image/jpeg", b"\xff\xd8\xff\xe0\x00\x04ab"), "without a size"),
        (answer("image/jpeg", jpeg(width=65_000, height=65_000)), "65000x65000 pixels"),
        (answer("image/jpeg", jpeg(), status="404 Not Found"), "answers 404"),
        (b"HTTP/1.1 302 Found\r\nLocation: file:///etc/passwd\r\n\r\n", "answers 302"),
        (answer("multipart/x-mixed-replace", jpeg()), "no boundary"),
        (STREAM, "has ended"),
        (STREAM + part(b"GIF89a", length=True), "no JPEG"),
        (STREAM + b"--frame\r\n" + b"X: " + b"y" * 100_000, "more than"),
        (STREAM + b"--frame\r\nContent-Length: 999999999\r\n\r\n" + jpeg(), "has ended"),
        (b"", ""),
    ],
)
def test_what_is_no_picture_is_told_and_not_passed_on(sent: bytes, told: str) -> None:
    assert told in trouble(lambda one: one.sendall(sent))


@pytest.mark.parametrize("head", [answer("image/jpeg"), STREAM + b"--frame\r\n\r\n", STREAM])
def test_an_answer_without_end_is_left(head: bytes) -> None:
    sent = [0]

    def flood(connection: socket.socket) -> None:
        connection.sendall(head)
        while True:
            connection.sendall(bytes(65536))
            sent[0] += 65536

    assert "more than" in trouble(flood)
    assert sent[0] < 3 * picture_relay.MOST_BYTES + 20_000_000  # what the kernel keeps of it


@pytest.mark.parametrize("head", [b"", answer("image/jpeg"), STREAM])
def test_a_camera_that_dawdles_is_left(head: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(picture_relay, "ANSWER_S", 0.3)
    ended = threading.Event()

    def dawdle(connection: socket.socket) -> None:
        connection.sendall(head)
        while head and not ended.wait(0.1):
            connection.sendall(b"\xff")
        ended.wait(20)

    try:
        assert trouble(dawdle)
    finally:
        ended.set()


def test_a_silent_camera_does_not_hold_up_the_end() -> None:
    begun, ended = threading.Event(), threading.Event()

    def wait(_connection: socket.socket) -> None:
        begun.set()
        ended.wait(60)

    with camera(wait) as url:
        with PictureRelay(url):
            assert begun.wait(20)
        ended.set()  # reached while the camera still waits


@pytest.mark.parametrize(
    "url",
    ["file:///etc/passwd", "ftp://camera/a.jpg", "camera", "http://", "http://camera:99999/",
     "http://camera/a b", "http://camera/\r\nX: y", "http://me:secret@camera/", ""],
)  # fmt: skip
def test_only_http_is_fetched(url: str) -> None:
    with pytest.raises(InputError):
        PictureRelay(url)
