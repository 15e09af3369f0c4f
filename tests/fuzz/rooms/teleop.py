"""Targets of steering and of pictures: keys, gamepads, browsers at a page or a stream, cameras."""

import io
import os
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import websockets.datastructures
from websockets.http11 import Request

from hexctl.control.drive.arbiter import Arbiter, Velocity
from hexctl.teleop.control_page import SOCKET_PATH, TOKEN_PREFIX, VIEW_PATH, ControlPage, page_html
from hexctl.teleop.gamepad import EVENT, EventFiles, GamepadEvents, StopButton, _bits
from hexctl.teleop.keyboard import REQUEST_KEYS, Keyboard
from hexctl.teleop.picture_relay import PictureRelay, _Incoming, _PictureError, jpeg_size
from hexctl.vision.detection import lens_calibration
from hexctl.vision.video.mjpeg import _Handler
from hexctl.wire.page_address import PageAddress
from tests.fuzz.target import JSON_WORDS, as_text, target, written


def _bounded(velocity: Velocity) -> None:
    assert all(-1 <= share <= 1 for share in velocity.array.tolist())


@cache
def _pipe() -> tuple[int, int]:
    return os.pipe()


@target(
    b"wwasd xq",
    b"\x1b[A\x1bOB\x1b[5n",
    b"\x1b[0ngu10",
    "w\N{PILE OF POO}".encode(),
    words=(b"\x1b[", b"\x1bO", b"\x1b[0n", b"\x1b"),
)
def read_keys(data: bytes) -> None:
    """Type an input in two ticks; a few more pass without a key."""
    arbiter, asked = Arbiter(lambda: 0.0), []
    reading, writing = _pipe()
    keyboard = Keyboard(
        arbiter.source("keyboard"),
        Velocity,
        lambda what, _: asked.append(what),
        reading,
        lambda _: None,
        now_s=lambda: 0.0,
    )
    middle = len(data) // 2
    for part in (data[:middle], data[middle:], b"", b"", b""):
        if part:
            os.write(writing, part)
        keyboard.poll()
        _bounded(arbiter.decide().velocity)
    assert set(asked) <= set(REQUEST_KEYS.values())


def _events(*each: tuple[int, int, int]) -> bytes:
    return b"".join(EVENT.pack(0, 0, *one) for one in each)


@target(
    _events((1, 310, 1), (3, 1, -32768), (0, 0, 0), (3, 0, 32767), (1, 305, 1)),
    _events((0, 3, 0), (3, 17, -1), (1, 310, 2), (1, 311, 0)),
    given=partial(written, "event0"),
)
def read_gamepad(path: Path) -> None:
    """Read events from a file, for a drive and for a stop."""
    events = GamepadEvents()
    files = EventFiles(lambda: [path], now_s=lambda: 0.0)
    files.look()
    for event in files.events():
        events.take(*event)
        assert all(-1 <= share <= 1 for share in events.shares)
        _ = events.enabled
    files.close()
    if path.stat().st_size % 8 == 0:
        button = StopButton(find=lambda: [path], now_s=lambda: 0.0)
        button.pressed()
        button.close()
    assert set(events.pressed) <= {"stop", "stand", "sit", "gait", "up", "down"}


@target(
    b"7cdb000000000000 0 0 0 0",
    b"3003f",
    given=as_text,
    refusals=(ValueError,),
    words=(b"0x", b"_", b"-"),
)
def read_capabilities(text: str) -> None:
    _bits(text)


class Page:
    """A page without a socket, and what it asked for."""

    def __init__(self, token: str | None) -> None:
        self.arbiter = Arbiter(lambda: 0.0)
        self.asked: list[str] = []
        self.page = ControlPage(
            PageAddress("127.0.0.1", 8080),
            page_html("drive"),
            self.arbiter.source("page"),
            Velocity,
            self.asked.append,
            token=token,
            now_s=lambda: 0.0,
        )


@cache
def _page(token: str | None) -> Page:
    return Page(token)


@target(
    b'{"v": [1, -0.5, 0.2]}',
    b'{"release": 1}',
    b'{"do": "stop"}',
    words=(*JSON_WORDS, b'"v":', b'"do"'),
)
def read_page_message(data: bytes) -> None:
    """Take a message as bytes and as text, of a client that drives and of another."""
    page = _page(None)
    for client in ("one", "two"):
        connection: Any = client
        page.page._take(connection, data)
        page.page._take(connection, data.decode("utf-8", "replace"))
        _bounded(page.arbiter.decide().velocity)
    page.page._let_go("one")  # type: ignore[arg-type]
    page.asked.clear()


@target(
    b"/\nHost:127.0.0.1:8080",
    b"/drive\nHost:127.0.0.1:8080\nOrigin:http://127.0.0.1:8080",
    b"/drive\nHost:localhost\nOrigin:http://localhost\nSec-WebSocket-Protocol:a, token.secretsecret",
    b"/view\nHost:[::1]:8080",
    words=(b"\nHost:", b"\nOrigin:", b"\nSec-WebSocket-Protocol:", b"token.", b"\xe9", b"::"),
)
def read_page_request(data: bytes) -> None:
    """Answer a request: its path, then lines of headers."""
    path, *lines = data.decode("latin-1").split("\n")
    headers = websockets.datastructures.Headers()
    for line in lines[:20]:
        name, _, value = line.partition(":")
        if value.isprintable() and name.replace("-", "").isalpha():  # others are refused as they are parsed
            headers[name] = value
    connection: Any = SimpleNamespace(server=None)
    for token in (None, "secretsecret"):
        page = _page(token).page
        answer = page._answer(connection, Request(path, headers))
        if answer is None:
            assert path in (SOCKET_PATH, VIEW_PATH)
            assert token is None or f"{TOKEN_PREFIX}{token}" in data.decode("latin-1")


@target(
    b"GET / HTTP/1.1\r\nHost: 127.0.0.1:1\r\n\r\n",
    b"GET /stream.mjpg HTTP/1.0\r\n\r\n",
    b"GET /elsewhere HTTP/1.1\r\nHost: localhost\r\n\r\n",
    words=(b"HTTP/1.1", b"\r\nHost: ", b"POST", b"\r\n\r\n"),
)
def read_stream_request(data: bytes) -> None:
    """Answer a request for the pictures of a rendered camera."""
    handler: Any = _Handler.__new__(_Handler)
    handler.rfile, handler.wfile = io.BytesIO(data), io.BytesIO()
    newest = SimpleNamespace(
        enter=lambda: False, leave=lambda: None, after=lambda _: (1, b"jpeg"), ended=True
    )
    handler.server = SimpleNamespace(newest=newest)
    handler.client_address = ("127.0.0.1", 1)
    handler.close_connection = True
    handler.handle_one_request()


class Answer:
    """What a camera sends, in pieces of growing size."""

    def __init__(self, data: bytes) -> None:
        self._data, self._size = data, 1

    def read1(self, most: int) -> bytes:
        """The next piece."""
        taken, self._data = self._data[: self._size], self._data[self._size :]
        self._size = min(2 * self._size, most)
        return taken


JPEG = (
    b"\xff\xd8\xff\xe0\x00\x10JFIF\0\1\1\0\0\1\0\1\0\0"
    b"\xff\xc0\0\x11\x08\x00\x10\x00\x20\3\1\x22\0\2\x11\1\3\x11\1"
)
PART = b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n%s\r\n" % (len(JPEG), JPEG)


@cache
def _relay() -> PictureRelay:
    return PictureRelay("http://127.0.0.1:1/")


@target(
    PART * 2,
    PART.replace(b"Content-Length", b"X-Length") * 2,
    JPEG,
    words=(b"--frame", b"\r\n\r\n", b"Content-Length: 999999999", b"\xff\xd8\xff"),
)
def read_picture_stream(data: bytes) -> None:
    """Keep what a camera streams until its stream ends, and take it for a single picture too."""
    relay = _relay()
    parts: Any = Answer(data)
    incoming = _Incoming(parts)
    with suppress(_PictureError, ValueError):
        while True:
            relay._keep(incoming.part(b"frame"))
    rest: Any = Answer(data)
    with suppress(_PictureError, ValueError):
        relay._keep(_Incoming(rest).rest())


@target(JPEG, refusals=(ValueError,), words=(b"\xff\xc0", b"\xff\xc4"))
def read_jpeg(data: bytes) -> None:
    width, height = jpeg_size(data)
    assert 0 <= width <= 65535
    assert 0 <= height <= 65535


def _png() -> bytes:
    import cv2

    return bytes(cv2.imencode(".png", np.zeros((8, 8), np.uint8))[1])


@target(_png(), given=partial(written, "still.jpg"), words=(b"IHDR", b"IDAT", b"\xff\xd8\xff"), times=5)
def read_picture(path: Path) -> None:
    assert lens_calibration.read_picture(path).ndim == 2
