"""Rerun's viewer in a browser: served on loopback, from this computer alone."""

import socket
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from urllib.parse import quote

from hexctl.errors import RecordingError
from hexctl.record.viewer import LOCAL, viewer_binary


@dataclass(frozen=True, slots=True)
class WebViewer:
    """A viewer that is being served.

    Attributes:
        url: where a browser finds it.
        process: Rerun's server.
    """

    url: str
    process: "subprocess.Popen[bytes]"

    def check(self) -> None:
        """Raise RecordingError when the server has ended."""
        if self.process.poll() is not None:
            raise RecordingError(f"the viewer's server ended with {self.process.returncode}")


def web_options(port: int, web_port: int) -> list[str]:
    """Return Rerun's options for a server of data and viewer at two ports of loopback."""
    return ["--bind", LOCAL, "--port", str(port), "--serve-web", "--web-viewer-port", str(web_port)]


def web_url(port: int, web_port: int) -> str:
    """Return the address that shows what is served at two ports."""
    return f"http://{LOCAL}:{web_port}/?url=rerun%2Bhttp%3A%2F%2F{LOCAL}%3A{port}%2Fproxy"


@contextmanager
def serve_web(web_port: int, urls: Sequence[str]) -> Iterator[WebViewer]:
    """Serve the viewer, showing recordings at some URLs, to browsers until the block ends.

    Raises RecordingError for a server that cannot start, MissingExtraError without Rerun.
    """
    command = [
        str(viewer_binary()),
        "--bind",
        LOCAL,
        "--serve-web",
        "--web-viewer-port",
        str(web_port),
        *urls,
    ]
    try:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
    except OSError as error:
        raise RecordingError(f"{command[0]}: the viewer does not start: {error.strerror}") from error
    query = "&".join(f"url={quote(url, safe='')}" for url in urls)
    try:
        yield WebViewer(f"{web_origin(web_port)}/?{query}", process)
    finally:
        process.kill()
        process.wait()


def web_origin(web_port: int) -> str:
    """Return where the viewer is served from."""
    return f"http://{LOCAL}:{web_port}"


def free_port() -> int:
    """Return a port of this machine that nobody listens at."""
    with socket.socket() as probe:
        probe.bind((LOCAL, 0))
        return int(probe.getsockname()[1])
