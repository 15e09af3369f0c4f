"""Rerun's viewer: in a window, or served to a browser on this computer."""

import importlib.util
import io
import os
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from http import HTTPStatus
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any, BinaryIO, Self
from urllib.parse import quote, unquote, urlencode

from hexctl.errors import InputError, MissingExtraError, RecordingError
from hexctl.files import file_instead
from hexctl.recording.rrd_reader import viewable
from hexctl.scratch import scratch_folder

LOCAL = "127.0.0.1"

NO_DISPLAY = "the viewer finds no display"


def viewer_binary() -> Path:
    """Rerun's executable; the `rerun` on the PATH is a wrapper that does not pass signals on.

    Raises MissingExtraError when it is not installed.
    """
    try:
        package = importlib.util.find_spec("rerun_cli")
    except ValueError:
        package = None
    if package is None or package.origin is None:
        raise MissingExtraError("the viewer", "view")
    return Path(package.origin).with_name("rerun")


def open_viewer(paths: Sequence[Path]) -> int:
    """Start the native viewer on recordings, wait until it is closed, and return its exit code.

    Raises InputError for a missing or damaged file or a file of another kind, RecordingError for a viewer
    that cannot start, and MissingExtraError without Rerun.
    """
    with scratch_folder() as spare:
        shown = [str(viewable(path, spare / str(number))) for number, path in enumerate(paths)]
        # A separate port: another open viewer keeps its content.
        options = ["--bind", LOCAL, "--port", "auto", *shown]
        with start_process([str(viewer_binary()), *options], stderr=subprocess.PIPE) as viewer:
            try:
                _, messages = viewer.communicate()
            except BaseException:
                viewer.kill()
                raise
    if viewer.returncode > 0:
        raise RecordingError(_why(messages.decode(errors="replace"), paths))
    return viewer.returncode


def start_process(command: Sequence[str], **options: Any) -> "subprocess.Popen[bytes]":
    """Start a program with options of `Popen`; raises RecordingError if it does not start."""
    try:
        return subprocess.Popen(command, **options)
    except OSError as error:
        raise RecordingError(f"{command[0]}: does not start: {error.strerror}") from error


def newest_recording(folder: Path, *, leave_out: str | None = None) -> Path:
    """Latest recording below a folder, except `leave_out`; raises InputError without any."""
    if (instead := file_instead(folder)) is not None:
        raise InputError(f"{instead}; allowed: a folder of recordings")
    found = [path for path in folder.rglob("*.rrd") if path.is_file() and path.name != leave_out]
    if not found:
        raise InputError(f"no recording (*.rrd) under {folder}; hexctl run writes one")
    return max(found, key=lambda path: (path.stat().st_mtime_ns, path.name))


def has_display() -> bool:
    """Whether this computer has a screen."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def check_display() -> None:
    """Raise RecordingError on a machine without a screen, where a window would fail silently."""
    if not has_display():
        raise RecordingError(f"{NO_DISPLAY}; hexctl view --web shows the same in a browser")


def _why(messages: str, paths: Sequence[Path]) -> str:
    names = " ".join(map(str, paths))
    if any(word in messages for word in ("DISPLAY", "WAYLAND", "neither", "NoDisplay", "XOpenDisplay")):
        return (
            f"{NO_DISPLAY}; hexctl view --web shows the same in a browser; or copy the folder "
            f"of {names} to a machine with one"
        )
    lines = [line.strip() for line in messages.splitlines() if line.strip()]
    last = next((line for line in reversed(lines) if "rror" in line), lines[-1] if lines else "no message")
    return f"the viewer ended with an error: {' '.join(last.split())[:200]}"


def web_options(web_port: int) -> list[str]:
    """Options of Rerun for a server of the viewer at a loopback port."""
    return ["--bind", LOCAL, "--serve-web", "--web-viewer-port", str(web_port)]


def web_url(port: int, web_port: int) -> str:
    """Address of the page that shows the data served at `port`."""
    return web_page(web_port, [f"rerun+http://{LOCAL}:{port}/proxy"])


@contextmanager
def serve_web(web_port: int, urls: Sequence[str]) -> Iterator["subprocess.Popen[bytes]"]:
    """Serve the viewer with recordings at some URLs; raises RecordingError or MissingExtraError."""
    quiet = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
    process = start_process([str(viewer_binary()), *web_options(web_port), *urls], **quiet)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def web_page(web_port: int, urls: Sequence[str]) -> str:
    """Address of a page of recordings, in the dark theme: light lines would be invisible on white."""
    return f"{web_origin(web_port)}/?{urlencode([('theme', 'dark'), *(('url', url) for url in urls)])}"


def web_origin(web_port: int) -> str:
    """Origin of the viewer's page."""
    return f"http://{LOCAL}:{web_port}"


def free_port() -> int:
    """Free TCP port of this machine."""
    with socket.socket() as probe:
        probe.bind((LOCAL, 0))
        return int(probe.getsockname()[1])


class FileServer:
    """HTTP server on loopback for added recordings; use as a context manager."""

    def __init__(self, origin: str) -> None:
        """Listen at a free loopback port; pages of one origin, such as http://127.0.0.1:9090, may read."""
        self._files: dict[str, Path] = {}
        self._closing, self._folder = ExitStack(), Path()  # of copies, once entered
        self._server = ThreadingHTTPServer((LOCAL, 0), self._handler(origin))
        self._thread = Thread(target=self._server.serve_forever, daemon=True)

    def __enter__(self) -> Self:
        self._folder = self._closing.enter_context(scratch_folder())
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._closing.close()

    def base(self, folder: str) -> str:
        """Base URL of the files of a folder."""
        return f"http://{LOCAL}:{self._server.server_port}/{quote(folder, safe='')}/"

    def add(self, folder: str, path: Path) -> str:
        """Serve a recording below a folder and return its URL; raises InputError for a bad file."""
        self._files[f"/{folder}/{path.name}"] = viewable(path, self._folder / folder)
        return self.base(folder) + quote(path.name)

    def _handler(self, origin: str) -> type[SimpleHTTPRequestHandler]:
        files = self._files

        def host() -> str:
            return f"{LOCAL}:{self._server.server_port}"

        class Handler(SimpleHTTPRequestHandler):
            def send_head(self) -> io.BytesIO | BinaryIO | None:
                if self.headers.get("Host") != host():
                    self.send_error(HTTPStatus.FORBIDDEN)  # a foreign host name, as by DNS rebinding
                elif unquote(self.path) not in files:
                    self.send_error(HTTPStatus.NOT_FOUND)
                else:
                    return super().send_head()
                return None

            def translate_path(self, path: str) -> str:
                return str(files[unquote(path)])

            def end_headers(self) -> None:
                self.send_header("Access-Control-Allow-Origin", origin)
                super().end_headers()

            def log_message(self, *_: Any) -> None:
                """Log nothing."""

        return Handler
