"""Steer a viewer that is open, through the control program that comes with it."""

import json
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from hexctl.errors import RecordingError

#: Until the viewer listens, and until it has loaded everything: with many files and no GPU that takes long.
CONNECT_S, LOAD_S = 20.0, 300.0

POLL_S = 0.2

PROTOCOL = "2024-11-05"


class ViewerControl:
    """Talks to the viewer that listens at a port of this machine; use as a context manager.

    The control program speaks the Model Context Protocol: a line of JSON-RPC there, a line back.
    """

    def __init__(self, binary: Path, port: int) -> None:
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
            self._pause(until_s)

    def show(self, recording_id: str, of: int) -> None:
        """Show a recording once all of so many are loaded; raises RecordingError when they are not."""
        until_s = time.monotonic() + LOAD_S
        while (location := self._location(recording_id, of)) is None:
            self._pause(until_s)
        self._try("rerun_set_location", location=location)

    def _location(self, recording_id: str, of: int) -> str | None:
        """Return where a recording is shown, or None while not all are loaded."""
        state = self._try("rerun_get_state") or {}
        recordings: Sequence[dict[str, Any]] = state.get("recordings", [])
        if len(recordings) < of or state.get("loading"):
            return None
        found = (str(each["location"]) for each in recordings if recording_id in each["store_id"])
        return next(found, None)

    def _pause(self, until_s: float) -> None:
        if time.monotonic() > until_s:
            raise RecordingError("the viewer does not answer")
        time.sleep(POLL_S)

    def _try(self, tool: str, **arguments: Any) -> dict[str, Any] | None:
        """Return what a tool says, or None when it refuses."""
        said = self._ask("tools/call", name=tool, arguments=arguments).get("result")
        if said is None or said.get("isError"):
            return None
        return said.get("structuredContent") or {}

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
