"""Pictures over HTTP on this computer: what a network camera sends, and what a browser shows."""

import socket
import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Self

from hexctl.errors import RobotFaultError, argument
from hexctl.wire.links import is_loopback

HOST = "127.0.0.1"

#: Paths of the stream, and of a page that shows it.
STREAM_PATH, PAGE_PATH = "/stream.mjpg", "/"

#: Clients at a time; further ones are refused.
MOST_CLIENTS = 8

#: Bytes that the kernel keeps for a client: one or two pictures, so that a slow one is not far behind.
SEND_BUFFER_BYTES = 131_072

#: A client that takes nothing for so long is left.
SEND_TIMEOUT_S = 5.0

#: How often a client that waits for a picture looks whether the server has ended.
POLL_S = 0.2

BOUNDARY = "hexctl-picture"

_PAGE = b"""<!doctype html><meta charset="utf-8"><title>hexctl</title>
<style>body{margin:0;background:#111}img{max-width:100vw;max-height:100vh;display:block;margin:auto}</style>
<img src="/stream.mjpg" alt="camera">
"""


class MjpegServer:
    """Serve the newest picture to all clients on loopback until it is closed.

    Each client has a thread and gets the newest picture when it is ready. A slow client misses pictures and
    delays no other. The stream is at `url`, a page that shows it at `page_url`.
    """

    def __init__(self, port: int = 0, *, host: str = HOST, option: str = "http_port") -> None:
        """Listen on a loopback address; port 0 is any free one. `option` names the port in messages.

        Raises RobotFaultError where the port cannot be used.
        """
        self._newest = _NewestPicture()
        try:
            self._server = (_Server6 if ":" in host else _Server)((host, port), _Handler)
        except OSError as error:
            raise RobotFaultError(
                f"{argument(option)}: got {port}, which cannot be used ({error.strerror}); "
                "allowed: a free port, or 0 for any"
            ) from error
        self._server.newest = self._newest
        shown = f"[{host}]" if ":" in host else host
        self.page_url = f"http://{shown}:{self._server.server_address[1]}{PAGE_PATH}"
        self.url = self.page_url.removesuffix(PAGE_PATH) + STREAM_PATH
        self._thread = threading.Thread(target=self._server.serve_forever, name="mjpeg", daemon=True)
        self._thread.start()

    @property
    def clients(self) -> int:
        """How many look at the stream now."""
        return self._newest.clients

    def publish(self, jpeg: bytes) -> None:
        """Make a picture the newest one; never waits for a client."""
        self._newest.put(jpeg)

    def close(self) -> None:
        """End all streams and stop to listen; a second call changes nothing."""
        self._newest.end()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class _NewestPicture:
    """The newest picture, for which any number of threads waits."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._jpeg: bytes | None = None
        self._number = 0
        self.ended = False
        self.clients = 0

    def put(self, jpeg: bytes) -> None:
        with self._changed:
            self._jpeg = jpeg
            self._number += 1
            self._changed.notify_all()

    def end(self) -> None:
        with self._changed:
            self.ended = True
            self._changed.notify_all()

    def after(self, number: int) -> tuple[int, bytes] | None:
        """The newest picture and its number once it is another one; None where none comes for a while."""
        with self._changed:
            self._changed.wait_for(lambda: self.ended or self._number > number, POLL_S)
            if self.ended or self._jpeg is None or self._number == number:
                return None
            return self._number, self._jpeg

    def enter(self) -> bool:
        """Count one more client, if there is room for it."""
        with self._changed:
            room = self.clients < MOST_CLIENTS
            self.clients += room
            return room

    def leave(self) -> None:
        with self._changed:
            self.clients -= 1


class _Server(ThreadingHTTPServer):
    """A server whose threads end with the process, and that ignores disconnecting clients."""

    daemon_threads = True
    block_on_close = False
    newest: _NewestPicture

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore it: a disconnected client is no error."""


class _Server6(_Server):
    address_family = socket.AF_INET6


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    timeout = SEND_TIMEOUT_S

    def log_message(self, format: str, *arguments: Any) -> None:  # noqa: A002  the name of the base class
        """Log nothing."""

    def do_GET(self) -> None:
        """Send the stream or the page."""
        if not self._asks_for_this_computer():
            self.send_error(HTTPStatus.FORBIDDEN)
        elif self.path == STREAM_PATH:
            self._stream()
        elif self.path == PAGE_PATH:
            self._page()
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    def _asks_for_this_computer(self) -> bool:
        """Whether the requested host name is this computer's. Prevents DNS rebinding."""
        name = self.headers.get("Host", HOST).rpartition(":")[0] or self.headers.get("Host", HOST)
        return is_loopback(name.removeprefix("[").removesuffix("]"))

    def _page(self) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(_PAGE)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(_PAGE)

    def _stream(self) -> None:
        newest = self.server.newest
        if not newest.enter():
            self.send_error(HTTPStatus.SERVICE_UNAVAILABLE, "too many clients")
            return
        try:
            self._send_pictures(newest)
        finally:
            newest.leave()

    def _send_pictures(self, newest: _NewestPicture) -> None:
        self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        self.connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={BOUNDARY}")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.close_connection = True
        number = 0
        while not newest.ended:
            found = newest.after(number)
            if found is None:
                continue
            number, jpeg = found
            head = f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
            self.wfile.write(head.encode() + jpeg + b"\r\n")
