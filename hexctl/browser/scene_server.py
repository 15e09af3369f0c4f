"""The web server of a 3D scene: viser, limited to pages of this computer.

viser checks neither where a socket comes from nor how much it sends, and takes another port if one is in use.
Here its sockets are accepted only from the page itself: requests for a foreign host name, and sockets of
foreign pages, are refused, and no page may embed it. It listens on loopback only. Messages beyond 200 a
second wait.

The page has a second socket, `/hexctl`, and further controls over viser's canvas.
"""

import asyncio
import gzip
import io
import logging
import os
import socket
import threading
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from http import HTTPStatus
from importlib.resources import files
from types import SimpleNamespace
from typing import Any, Self, cast

from hexctl.errors import RobotFaultError, argument
from hexctl.robot.model import Robot
from hexctl.teleop.page_connection import Allowance

LOOPBACK = "127.0.0.1"

#: Path of the page's second socket.
SOCKET_PATH = "/hexctl"

#: Messages of a client per second, and bytes of the longest one. The page sends its camera while it moves.
MESSAGES_S, MOST_BYTES = 200.0, 65_536

#: Maximum number of sockets; each page has two.
MOST_SOCKETS = 64

#: Nothing from elsewhere, and no page around this one, which could place its own buttons over it.
POLICY = "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"

#: Where the camera begins, in stance radii.
CAMERA = (-1.9, -2.6, 1.9)

#: Quiet: a client that sends nonsense is disconnected, which is no error of ours.
_LOGGER = logging.getLogger("hexctl.browser.sockets")
_LOGGER.addHandler(logging.NullHandler())
_LOGGER.propagate = False

#: Handles one connection of the second socket.
Talk = Callable[[Any], Awaitable[None]]


class SceneServer:
    """A viser server (`viser`) at `url`; a context manager.

    Args:
        port: 0 takes any free one.
        title: of the page.
        controls: HTML of further controls, with script and style; empty for none.
        talk: serves the second socket; None refuses it.

    Raises RobotFaultError for a port in use, MissingExtraError without viser.
    """

    def __init__(self, port: int, *, title: str, controls: str = "", talk: Talk | None = None) -> None:
        import viser

        self._talk = talk
        self._page = gzip.compress(_page(title, controls))
        self._sockets = 0
        self._socket = _listening(port)
        self.port: int = self._socket.getsockname()[1]
        self._checks = False
        with _serving(self._serve), redirect_stdout(io.StringIO()):  # viser prints its address
            self.viser = viser.ViserServer(host=LOOPBACK, port=self.port, verbose=False)
        if not self._checks:  # another viser, which must not serve without them
            self.__exit__()
            raise RobotFaultError("the page: this viser starts its server in another way; install viser 1.1")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        with redirect_stdout(io.StringIO()):  # viser prints its end
            self.viser.stop()
        self._socket.close()

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{LOOPBACK}:{self.port}/"

    def _serve(self, handler: Talk, _host: str, _port: int, **options: Any) -> Any:
        """Serve viser's handler behind our checks, on our socket."""
        from websockets.asyncio.server import serve
        from websockets.exceptions import ConnectionClosed

        self._checks, answer = True, options.pop("process_request")

        async def handled(connection: Any) -> None:
            self._sockets += 1
            try:
                if connection.request.path == SOCKET_PATH and self._talk is not None:
                    await self._talk(connection)
                else:
                    await handler(connection)
            except ConnectionClosed:
                pass
            finally:
                self._sockets -= 1

        def checked(connection: Any, request: Any) -> Any:
            return self._refusal(request) or self._own_page(request) or answer(connection, request)

        options |= {"process_request": checked, "max_size": MOST_BYTES, "logger": _LOGGER}
        return serve(handled, sock=self._socket, create_connection=_patient_connection(), **options)

    def _refusal(self, request: Any) -> Any:
        hosts = {f"{name}:{self.port}" for name in (LOOPBACK, "localhost")}
        if _one(request, "Host").lower() not in hosts:
            return _response(HTTPStatus.FORBIDDEN, b"another host; allowed: 127.0.0.1\n")
        if "upgrade" not in _one(request, "Connection").lower():
            return None
        if _one(request, "Origin").lower() not in {f"http://{host}" for host in hosts}:
            return _response(HTTPStatus.FORBIDDEN, b"another origin\n")
        if self._sockets >= MOST_SOCKETS:
            return _response(HTTPStatus.SERVICE_UNAVAILABLE, b"too many clients\n")
        if request.path == SOCKET_PATH and self._talk is None:
            return _response(HTTPStatus.NOT_FOUND, b"no socket here\n")
        return None

    def _own_page(self, request: Any) -> Any:
        if request.path.partition("?")[0] not in ("/", "/index.html") or request.headers.get("Upgrade"):
            return None
        return _response(HTTPStatus.OK, self._page, html=True)


def light_scene(viser: Any, robot: Robot) -> None:
    """Aim the camera at a robot, in a light that costs little without a graphics card: it is not mirrored."""
    scene, camera, radius_m = viser.scene, viser.initial_camera, robot.stance_radius_m
    scene.set_up_direction("+z")
    scene.configure_default_lights(enabled=True, cast_shadow=False)
    scene.configure_environment_map(None)
    scene.add_light_ambient("/light", intensity=0.9)
    viser.gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
    camera.position = tuple(share * radius_m for share in CAMERA)
    camera.look_at = (0.0, 0.0, 0.5 * robot.standing_height_m)


def _page(title: str, controls: str) -> bytes:
    """Page of viser, with our script before its own and our controls over its canvas."""
    page = (files("viser") / "client/build/index.html").read_text(encoding="utf-8")
    light = files("hexctl.browser").joinpath("light.js").read_text(encoding="utf-8")
    page = page.replace("<title>Viser</title>", f"<title>{title}</title><script>{light}</script>", 1)
    return page.replace("<body>", f"<body>{controls}", 1).encode()


def _listening(port: int) -> socket.socket:
    """A listening socket on loopback; raises RobotFaultError for a port in use."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((LOOPBACK, port))
        listener.listen()
    except OSError as error:
        listener.close()
        why = os.strerror(error.errno) if error.errno else error
        raise RobotFaultError(
            f"{argument('page_port')}: cannot listen on {LOOPBACK}:{port} ({why}); allowed: a free port, or "
            "0, which takes any"
        ) from error
    return listener


_REPLACING = threading.Lock()


@contextmanager
def _serving(serve: Callable[..., Any]) -> Iterator[None]:
    """Let viser serve by our function, which it would otherwise take from websockets, while it starts."""
    import websockets.datastructures
    import websockets.exceptions
    from viser.infra import _infra

    ours = SimpleNamespace(
        asyncio=SimpleNamespace(server=SimpleNamespace(serve=serve)),
        exceptions=websockets.exceptions,
        datastructures=websockets.datastructures,
    )
    with _REPLACING:
        theirs, _infra.websockets = _infra.websockets, ours
        try:
            yield
        finally:
            _infra.websockets = theirs


def _patient_connection() -> Any:
    """Class of connections that take no more than 200 messages a second: the others wait in the network."""
    from websockets.asyncio.server import ServerConnection

    class PatientConnection(ServerConnection):
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            self._allowance = Allowance(MESSAGES_S)

        async def recv(self, decode: bool | None = None) -> Any:
            while not self._allowance.take():
                await asyncio.sleep(1 / MESSAGES_S)
            return await super().recv(decode)

    return PatientConnection


def _one(request: Any, name: str) -> str:
    """Value of a header; empty if it is missing or repeated."""
    values = request.headers.get_all(name)
    return cast(str, values[0]) if len(values) == 1 else ""


def _response(status: HTTPStatus, body: bytes, *, html: bool = False) -> Any:
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    headers = Headers(
        {
            "Content-Type": "text/html; charset=utf-8" if html else "text/plain",
            "Content-Length": str(len(body)),
            "Content-Security-Policy": POLICY,
            "X-Content-Type-Options": "nosniff",
            "Cache-Control": "no-store",
        }
    )
    if html:
        headers["Content-Encoding"] = "gzip"
    return Response(status, status.phrase, headers, body)
