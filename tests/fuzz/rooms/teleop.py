"""Targets that steer: keys of a terminal, gamepads, and what browsers send to the page and to a stream."""

import io
import os
from functools import cache
from types import SimpleNamespace
from typing import Any

import websockets.datastructures
from websockets.http11 import Request

from hexctl.control.drive.arbiter import Arbiter, Velocity
from hexctl.teleop.drive_page import SOCKET_PATH, TOKEN_PREFIX, VIEW_PATH, DrivePage
from hexctl.teleop.gamepad import EVENT, EventFiles, GamepadEvents, StopButton, _bits
from hexctl.teleop.keyboard import REQUEST_KEYS, Keyboard
from hexctl.vision.video.mjpeg import _Handler
from hexctl.wire.page_address import PageAddress
from tests.fuzz.folder import written
from tests.fuzz.target import Target


def _bounded(velocity: Velocity) -> None:
    assert all(-1 <= share <= 1 for share in velocity.array.tolist())


@cache
def _pipe() -> tuple[int, int]:
    return os.pipe()


def _keys(data: bytes) -> None:
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


def _gamepad(data: bytes) -> None:
    """Read events from a file, for a drive and for a stop."""
    events = GamepadEvents()
    with written("event0", data) as path:
        files = EventFiles(lambda: [path], now_s=lambda: 0.0)
        files.look()
        for event in files.events():
            events.take(*event)
            assert all(-1 <= share <= 1 for share in events.shares)
            _ = events.held
        files.close()
        if len(data) % 8 == 0:
            button = StopButton(find=lambda: [path], now_s=lambda: 0.0)
            button.pressed()
            button.close()
    assert set(events.pressed) <= {"stop", "stand", "sit", "gait", "up", "down"}


def _capabilities(data: bytes) -> None:
    _bits(data.decode("utf-8", "surrogateescape"))


class Page:
    """A page without a socket, and what it asked for."""

    def __init__(self, token: str | None) -> None:
        self.arbiter = Arbiter(lambda: 0.0)
        self.asked: list[str] = []
        self.page = DrivePage(
            PageAddress("127.0.0.1", 8080),
            self.arbiter.source("page"),
            Velocity,
            self.asked.append,
            token=token,
            now_s=lambda: 0.0,
        )


@cache
def _page(token: str | None) -> Page:
    return Page(token)


def _message(data: bytes) -> None:
    """Take a message as bytes and as text, of a client that drives and of another."""
    page = _page(None)
    for client in ("one", "two"):
        connection: Any = client
        page.page._take(connection, data)
        page.page._take(connection, data.decode("utf-8", "replace"))
        _bounded(page.arbiter.decide().velocity)
    page.page._let_go("one")  # type: ignore[arg-type]
    page.asked.clear()


def _request(data: bytes) -> None:
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


def _stream(data: bytes) -> None:
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


def _events(*each: tuple[int, int, int]) -> bytes:
    return b"".join(EVENT.pack(0, 0, *one) for one in each)


TARGETS = (
    Target(
        name="keys",
        read=_keys,
        seeds=(b"wwasd xq", b"\x1b[A\x1bOB\x1b[5n", b"\x1b[0ngu10", "w\N{PILE OF POO}".encode()),
        words=(b"\x1b[", b"\x1bO", b"\x1b[0n", b"\x1b"),
        most_bytes=250,
    ),
    Target(
        name="gamepad",
        read=_gamepad,
        seeds=(
            _events((1, 310, 1), (3, 1, -32768), (0, 0, 0), (3, 0, 32767), (1, 305, 1)),
            _events((0, 3, 0), (3, 17, -1), (1, 310, 2), (1, 311, 0)),
        ),
        most_bytes=480,
    ),
    Target(
        name="capabilities",
        read=_capabilities,
        seeds=(b"7cdb000000000000 0 0 0 0", b"3003f"),
        refusals=(ValueError,),
        words=(b"0x", b"_", b"-"),
        most_bytes=200,
    ),
    Target(
        name="page-message",
        read=_message,
        seeds=(b'{"v": [1, -0.5, 0.2]}', b'{"release": 1}', b'{"do": "stop"}'),
        words=(b"NaN", b"1e400", b"9" * 400, b'"v":', b'"do"', b"null", b"[" * 50, b'"\\ud800"'),
        most_bytes=600,
    ),
    Target(
        name="page-request",
        read=_request,
        seeds=(
            b"/\nHost:127.0.0.1:8080",
            b"/drive\nHost:127.0.0.1:8080\nOrigin:http://127.0.0.1:8080",
            b"/drive\nHost:localhost\nOrigin:http://localhost\nSec-WebSocket-Protocol:a, token.secretsecret",
            b"/view\nHost:[::1]:8080",
        ),
        words=(b"\nHost:", b"\nOrigin:", b"\nSec-WebSocket-Protocol:", b"token.", b"\xe9", b"::"),
        most_bytes=400,
    ),
    Target(
        name="stream-request",
        read=_stream,
        seeds=(
            b"GET / HTTP/1.1\r\nHost: 127.0.0.1:1\r\n\r\n",
            b"GET /stream.mjpg HTTP/1.0\r\n\r\n",
            b"GET /elsewhere HTTP/1.1\r\nHost: localhost\r\n\r\n",
        ),
        words=(b"HTTP/1.1", b"\r\nHost: ", b"POST", b"\r\n\r\n"),
        most_bytes=300,
    ),
)
