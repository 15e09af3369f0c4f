"""Rerun's viewer in a browser: served on loopback, from this computer alone."""

import socket
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from hexctl.errors import RecordingError
from hexctl.record.viewer import LOCAL, check_recording, viewer_binary


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
def serve_web(paths: Sequence[Path]) -> Iterator[WebViewer]:
    """Serve recordings to browsers until the block ends.

    Raises InputError for a missing file or a file of another kind, RecordingError for a server that cannot
    start, MissingExtraError without Rerun.
    """
    for path in paths:
        check_recording(path)
    port, web_port = free_port(), free_port()
    command = [str(viewer_binary()), *web_options(port, web_port), *map(str, paths)]
    try:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
    except OSError as error:
        raise RecordingError(f"{command[0]}: the viewer does not start: {error.strerror}") from error
    try:
        yield WebViewer(web_url(port, web_port), process)
    finally:
        process.kill()
        process.wait()


def free_port() -> int:
    """Return a port of this machine that nobody listens at."""
    with socket.socket() as probe:
        probe.bind((LOCAL, 0))
        return int(probe.getsockname()[1])
