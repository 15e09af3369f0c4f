"""Steer a viewer that is open, through the control program that comes with it."""

import json
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from hexctl.errors import RecordingError

#: A viewer that does not listen by then never will.
CONNECT_S = 30.0

#: When no more recordings have come for so long, all have.
SETTLED_S = 10.0

POLL_S = 0.2

PROTOCOL = "2024-11-05"


class ViewerControl:
    """Talks to the viewer that listens at a port of this machine; use as a context manager.

    The control program speaks the Model Context Protocol: a line of JSON-RPC there, a line back.
    """

    def __init__(self, binary: Path, port: int, alive: Callable[[], bool]) -> None:
        """Start the control program.

        Args:
            binary: Rerun's program.
            port: where the viewer listens.
            alive: whether the viewer is open; when it is not, waiting ends.
        """
        self._alive = alive
        self._endpoint = f"http://127.0.0.1:{port}"
        command = [str(binary), "viewer-mcp"]
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(
            command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, text=True
        )
        self._sent = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.communicate()

    def connect(self) -> None:
        """Wait until the viewer listens; raises RecordingError when it does not."""
        client = {"name": "hexctl", "version": "0"}
        self._ask("initialize", protocolVersion=PROTOCOL, capabilities={}, clientInfo=client)
        self._say({"method": "notifications/initialized"})
        until_s = time.monotonic() + CONNECT_S
        while self._try("rerun_connect", endpoint=self._endpoint) is None:
            if time.monotonic() > until_s:
                raise RecordingError("the viewer does not listen")
            self._pause()

    def show(self, recording_id: str, of: int) -> None:
        """Show a recording once so many are loaded, because each that is loaded shows itself.

        Waits no longer for those that cannot be loaded. Raises RecordingError when it is not among them.
        """
        loaded: list[dict[str, Any]] = []
        grown_s = time.monotonic()
        while len(loaded) < of and time.monotonic() < grown_s + SETTLED_S:
            self._pause()
            state = self._try("rerun_get_state") or {}
            recordings = state.get("recordings", [])
            if len(recordings) > len(loaded):
                loaded, grown_s = recordings, time.monotonic()
        found = [each["location"] for each in loaded if recording_id in each["store_id"]]
        if not found:
            raise RecordingError("the viewer did not load the overview")
        self._try("rerun_set_location", location=found[0])

    def _pause(self) -> None:
        if not self._alive():
            raise RecordingError("the viewer was closed")
        time.sleep(POLL_S)

    def _try(self, tool: str, **arguments: Any) -> dict[str, Any] | None:
        """Return what a tool says, or None when it refuses."""
        said = self._ask("tools/call", name=tool, arguments=arguments).get("result")
        if said is None or said.get("isError"):
            return None
        content: dict[str, Any] = json.loads(said["content"][0]["text"])
        return content

    def _ask(self, method: str, **params: Any) -> dict[str, Any]:
        self._sent += 1
        self._say({"id": self._sent, "method": method, "params": params})
        stdout = self._process.stdout
        for line in stdout or ():
            answer: dict[str, Any] = json.loads(line)
            if answer.get("id") == self._sent:
                return answer
        raise RecordingError("the viewer's control program ended")

    def _say(self, message: dict[str, Any]) -> None:
        stdin = self._process.stdin
        if stdin is not None:
            stdin.write(json.dumps({"jsonrpc": "2.0", **message}) + "\n")
            stdin.flush()
