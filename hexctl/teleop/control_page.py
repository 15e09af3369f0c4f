"""A page that moves a robot by phone or browser: one file over HTTP and a WebSocket on the same port.

`hexctl drive` and `hexctl calibrate` serve theirs with it.

Messages to the robot are JSON: `{"v": [forward, left, turn]}` with shares of the maximum speeds, -1 to 1, 20
to 50 times a second while a finger is down; `{"release": true}` when it lifts; `{"do": "stop"}` for other
requests. A page with an owner also sends `{"here": true}` once a second. The robot sends its status at 10 Hz,
with the `owner`: "you", the address of the client that moves it, or null. Pictures of a camera have a second
socket, so as not to delay the status: any message asks for the next picture, answered by one message, or by
JSON `{"trouble": why}`.

A client that sends more than 100 messages a second is disconnected. A stop is handled before parsing and
counting. With 16 clients, a silent one is replaced by a new one.

Every client may move the robot. The page is therefore limited to this computer unless a token and TLS are
configured; requests for a foreign host name, and sockets of foreign pages, are refused.
"""

import asyncio
import errno
import hmac
import ipaddress
import json
import math
import os
import secrets
import ssl
import threading
import time
from collections.abc import Callable
from functools import partial
from http import HTTPStatus
from importlib.resources import files
from typing import Any, Self, cast

from websockets.asyncio.server import Server, ServerConnection, broadcast, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from hexctl.control.drive.arbiter import COMMAND_EXPIRY_S, VelocitySource
from hexctl.errors import HexctlError, RobotFaultError, argument
from hexctl.teleop.keyboard import Share
from hexctl.teleop.page_connection import Addresses, LimitedConnection, least_needed
from hexctl.teleop.picture_relay import PERIOD_S, Picture, PictureRelay
from hexctl.wire.certificates import Credentials, hosts_of_this_computer
from hexctl.wire.page_address import PageAddress

#: Path of the socket, and the name of its protocol. A token is sent in the same header, which logs omit.
SOCKET_PATH, PROTOCOL, TOKEN_PREFIX = "/drive", "hexctl.drive.1", "token."

#: Path of the socket of pictures, and the maximum number of its clients.
VIEW_PATH, MOST_VIEWERS = "/view", 4

#: How long a client waits for a picture.
PICTURE_WAIT_S = 1.0

#: Time between two reports.
REPORT_S = 0.1

#: Bytes of the longest message, and number of clients.
MOST_BYTES, MOST_CLIENTS = 256, 16

#: Connections that wait to be accepted. All are accepted before the next message is read.
BACKLOG = 16

#: The stop as the page sends it, without spaces.
STOP_MESSAGE = '{"do":"stop"}'

#: Maximum time of the server's start and end.
START_S = 5.0

#: Answer to a foreign host name. It does not reveal the valid names.
OTHER_HOST = b"not a name of this computer; allowed: its address, such as 192.168.1.7, or its host name\n"

#: Content policy of the page: nothing from elsewhere.
POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; connect-src 'self' ws: wss:; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)


def page_html(name: str) -> bytes:
    """A page of this package, with what pages have in common in its place."""
    return with_common_parts(_PAGES.joinpath(f"{name}.html").read_text(encoding="utf-8")).encode()


def with_common_parts(html: str) -> str:
    """A page with styles and scripts of `pages` in place of comments that name them."""
    for part in ("control.css", "control.js", "robot.js", "sticks.js"):
        html = html.replace(f"/* {part} */", _PAGES.joinpath(part).read_text(encoding="utf-8"))
    return html


_PAGES = files("hexctl.teleop").joinpath("pages")


def new_token() -> str:
    """A random token: 60 bits in easily typed letters."""
    return "".join(secrets.choice("abcdefghjkmnpqrstuvwxyz23456789") for _ in range(12))


class ControlPage:
    """Serves the page from its own thread; a context manager.

    One client drives at a time: the first that touches the stick, until it releases it or falls silent. Any
    may stop the robot. A stick held during a clear of a stop is ignored until it is released.

    With `owned_s` one client owns the page, until it leaves or is silent for so long. Of others only a stop
    counts.

    Beyond loopback, credentials for TLS and a token are required; None makes a token. Raises InputError for
    an address beyond loopback without credentials.
    """

    def __init__(
        self,
        address: PageAddress,
        html: bytes,
        source: VelocitySource,
        share: Share,
        ask: Callable[[str], None],
        *,
        credentials: Credentials | None = None,
        token: str | None = None,
        pictures: PictureRelay | None = None,
        owned_s: float | None = None,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        address.check(secured=credentials is not None)
        self.token = new_token() if token is None and not address.loopback else token
        self._address, self._credentials = address, credentials
        self._source, self._share, self._ask, self._now_s = source, share, ask, now_s
        self.port = address.port
        self._names = {name.lower() for name in (*hosts_of_this_computer([]), "localhost", address.host)}
        self._page = html if pictures is None else html.replace(b"<html ", b"<html data-view ", 1)
        self._pictures, self._owned = pictures, owned_s is not None
        self._keeps_s = COMMAND_EXPIRY_S if owned_s is None else owned_s
        self._status = "{}"
        self._driver: ServerConnection | None = None
        self._driver_at_s = -math.inf
        self._forgets: int | None = None  # of the source when the stick was touched
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._begun = threading.Event()
        self._failed: Exception | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._end: asyncio.Event | None = None

    @property
    def url(self) -> str:
        """Address of the page, without the token."""
        scheme = "http" if self._credentials is None else "https"
        host = self._address.host
        if host in ("0.0.0.0", "::"):  # noqa: S104  compared, not listened on
            host = hosts_of_this_computer([])[0]
        return f"{scheme}://{f'[{host}]' if ':' in host else host}:{self.port}/"

    def __enter__(self) -> Self:
        """Start to listen; raises RobotFaultError if that fails."""
        self._thread.start()
        if not self._begun.wait(START_S):
            raise RobotFaultError("page: does not start")
        if self._failed is not None:
            place = f"{self._address.host}:{self._address.port}"
            number = getattr(self._failed, "errno", None)  # asyncio's text repeats the address
            why = os.strerror(number) if number in (errno.EADDRINUSE, errno.EACCES) else self._failed
            raise RobotFaultError(
                f"{argument('page')}: cannot listen on {place} ({why}); allowed: an address of this computer "
                "and a free port, such as 127.0.0.1:0, which takes any"
            ) from self._failed
        return self

    def __exit__(self, *error: object) -> None:
        if self._loop is not None and self._end is not None and self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._end.set)
            self._thread.join(START_S)

    def poll(self) -> None:
        """Nothing: messages arrive on the page's thread."""

    def report(self, status: dict[str, Any]) -> None:
        """Report the robot's status to clients."""
        self._status = json.dumps(status)

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except (OSError, ssl.SSLError, OverflowError) as error:
            self._failed = error
        finally:
            self._begun.set()
            self._source.release()

    async def _serve(self) -> None:
        self._loop, self._end = asyncio.get_running_loop(), asyncio.Event()
        context = None
        if self._credentials is not None:
            context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            context.load_cert_chain(self._credentials.certificate, self._credentials.key)
        async with serve(
            self._talk,
            self._address.host,
            self._address.port,
            ssl=context,
            process_request=self._answer,
            # Declared as a class, used as a callable.
            create_connection=cast(type[ServerConnection], partial(LimitedConnection, addresses=Addresses())),
            backlog=BACKLOG,
            subprotocols=[Subprotocol(PROTOCOL)],
            max_size=MOST_BYTES,
            compression=None,
            open_timeout=START_S,
            close_timeout=1.0,
            server_header=None,
        ) as server:
            self.port = next(iter(server.sockets)).getsockname()[1]
            self._begun.set()
            reports = asyncio.create_task(self._send_reports(server))
            await self._end.wait()
            reports.cancel()

    async def _send_reports(self, server: Server) -> None:
        while True:
            owner, status, clients = self._owner(), self._status[:-1], _on(server, SOCKET_PATH)
            for one in clients:
                name = None if owner is None else "you" if one is owner else owner.address
                comma = ", " if len(status) > 1 else ""
                # A client that does not read must not delay the others.
                broadcast([one], f'{status}{comma}"owner": {json.dumps(name)}}}')
            await asyncio.sleep(REPORT_S)

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """The page, a refusal, or None for the socket."""
        host = _one(request.headers, "Host")
        if not self._is_ours(host):
            return _response(HTTPStatus.FORBIDDEN, OTHER_HOST)
        if request.path != SOCKET_PATH and (self._pictures is None or request.path != VIEW_PATH):
            found = request.path == "/"
            body = self._page if found else b"not found\n"
            return _response(HTTPStatus.OK if found else HTTPStatus.NOT_FOUND, body, html=found)
        scheme = "http" if self._credentials is None else "https"
        if _one(request.headers, "Origin").lower() != f"{scheme}://{host}".lower():
            return _response(HTTPStatus.FORBIDDEN, b"another origin\n")
        if not self._knows_token(request.headers):
            return _response(HTTPStatus.FORBIDDEN, b"wrong token\n")
        if request.path == SOCKET_PATH:
            self._make_room(cast(LimitedConnection, connection))
        elif len(_on(connection.server, VIEW_PATH)) >= MOST_VIEWERS:
            return _response(HTTPStatus.SERVICE_UNAVAILABLE, b"too many clients\n")
        return None

    def _make_room(self, newcomer: LimitedConnection) -> None:
        """If there are too many clients, disconnect one, but never the one that drives."""
        others = [one for one in _on(newcomer.server, SOCKET_PATH) if not one.closed_for_new_client]
        if len(others) >= MOST_CLIENTS:
            owner = self._owner()
            least_needed([one for one in others if one is not owner], newcomer.address).close_for_new_client()

    def _owner(self) -> LimitedConnection | None:
        """The client that the robot listens to now."""
        silent = self._now_s() - self._driver_at_s > self._keeps_s
        return None if silent else cast("LimitedConnection | None", self._driver)

    def _is_ours(self, host: str) -> bool:
        """Whether a Host header is a name or an address of this computer, which DNS rebinding is not."""
        name = host.lower()
        if name.startswith("["):
            name = name[1:].partition("]")[0]
        elif name.count(":") <= 1:
            name = name.partition(":")[0]
        if name in self._names or name.removesuffix(".local") in self._names:
            return True
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True

    def _knows_token(self, headers: Headers) -> bool:
        if self.token is None:
            return True
        said = ",".join(headers.get_all("Sec-WebSocket-Protocol"))
        words = [word.strip() for word in said.split(",")]
        given = [word.removeprefix(TOKEN_PREFIX) for word in words if word.startswith(TOKEN_PREFIX)]
        return any(hmac.compare_digest(word.encode(), self.token.encode()) for word in given)

    async def _talk(self, connection: ServerConnection) -> None:
        try:
            if connection.request is not None and connection.request.path == VIEW_PATH:
                await self._show(connection)
            async for message in connection:
                stops = _is_stop(message)
                if stops:
                    self._ask("stop")
                if not cast(LimitedConnection, connection).may_send():
                    break
                if not stops:
                    self._take(connection, message)
                await asyncio.sleep(0)  # take waiting messages one by one, clients in turn
        except ConnectionClosed:
            pass
        finally:
            self._let_go(connection)

    async def _show(self, connection: ServerConnection) -> None:
        shown = 0
        async for _ in connection:
            if not cast(LimitedConnection, connection).may_send():
                break
            picture = await self._picture_after(shown)
            if picture is None:
                why = None if self._pictures is None else self._pictures.trouble
                await connection.send(json.dumps({"trouble": why or "none comes"}))
            else:
                shown = picture.number
                await connection.send(picture.jpeg)

    async def _picture_after(self, number: int) -> Picture | None:
        for _ in range(round(PICTURE_WAIT_S / PERIOD_S)):
            newest = None if self._pictures is None else self._pictures.newest
            if newest is not None and newest.number != number:
                return newest
            await asyncio.sleep(PERIOD_S)
        return None

    def _take(self, connection: ServerConnection, message: str | bytes) -> None:
        try:
            said = json.loads(message)
            if "do" in said:
                if not self._owned or self._drives(connection):
                    self._ask(str(said["do"]))
            elif "release" in said:
                self._release(connection)
            elif "here" in said:
                if self._owned:
                    self._drives(connection)
            elif self._drives(connection):
                shares = [float(value) for value in said["v"]]
                allowed = len(shares) == 3 and all(-1 <= value <= 1 for value in shares)
                self._forgets = self._source.forgets if self._forgets is None else self._forgets
                if allowed and self._forgets == self._source.forgets:
                    self._source.command(self._share(*shares))
        except (ValueError, TypeError, KeyError, OverflowError, HexctlError, RecursionError):
            return

    def _drives(self, connection: ServerConnection) -> bool:
        """Whether a client that touches the stick now drives."""
        now_s = self._now_s()
        if self._owner() not in (None, connection):
            return False
        if self._driver is not connection:
            self._forgets = None
        self._driver, self._driver_at_s = connection, now_s
        return True

    def _release(self, connection: ServerConnection) -> None:
        if not self._owned:
            self._let_go(connection)
        elif self._driver is connection:
            self._forgets = None
            self._source.release()

    def _let_go(self, connection: ServerConnection) -> None:
        if self._driver is connection:
            self._driver, self._driver_at_s = None, -math.inf
            self._source.release()


def _on(server: Server | None, path: str) -> list[LimitedConnection]:
    connections = cast("set[LimitedConnection]", set() if server is None else server.connections)
    return [one for one in connections if one.request is not None and one.request.path == path]


def _is_stop(message: str | bytes) -> bool:
    """Spaces are allowed."""
    return isinstance(message, str) and "".join(message.split()) == STOP_MESSAGE


def _one(headers: Headers, name: str) -> str:
    """Value of a header; empty if it is missing or repeated."""
    values = headers.get_all(name)
    return values[0] if len(values) == 1 else ""


def _response(status: HTTPStatus, body: bytes, *, html: bool = False) -> Response:
    headers = Headers(
        {
            "Content-Type": "text/html; charset=utf-8" if html else "text/plain",
            "Content-Length": str(len(body)),
            "Connection": "close",
            "Cache-Control": "no-store",
            "Content-Security-Policy": POLICY,
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
        }
    )
    return Response(status.value, status.phrase, headers, body)
