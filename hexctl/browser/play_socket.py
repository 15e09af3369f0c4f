"""The page's second socket: sticks and keys to the robot, its status to the page.

Messages to the robot are JSON: `{"v": [forward, left, turn]}` with shares of the maximum speeds, -1 to 1,
while a key or stick is held; `{"release": true}` after it; `{"do": "stop"}` for other requests. The status
goes to all pages at 10 Hz. One page drives at a time; any may stop the robot.
"""

import asyncio
import json
from collections.abc import Callable
from typing import Any

from hexctl.control.drive.arbiter import COMMAND_EXPIRY_S, VelocitySource
from hexctl.errors import HexctlError
from hexctl.teleop.keyboard import Share
from hexctl.time_source import WALL_TIME


class PlaySocket:
    """Sticks and keys of pages as a source of velocities; `attach` gives it a robot."""

    def __init__(self) -> None:
        self._pages: set[Any] = set()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._driver: Any = None
        self._driven_at_s = 0.0
        self._robot: tuple[VelocitySource, Share, Callable[[str], None]] | None = None

    def attach(self, source: VelocitySource, share: Share, ask: Callable[[str], None]) -> None:
        """Drive a robot from now on; `ask` takes other requests, from the thread of the server."""
        self._robot = source, share, ask

    def detach(self) -> None:
        """Drive no robot."""
        self._robot = None

    async def talk(self, connection: Any) -> None:
        """Serve a page until it leaves."""
        self._loop = asyncio.get_running_loop()
        self._pages.add(connection)
        try:
            async for message in connection:
                self._take(connection, message)
        finally:
            self._pages.discard(connection)
            self._release(connection)

    def report(self, status: dict[str, Any]) -> None:
        """Send a status to all pages; from any thread."""
        if self._loop is None or not self._pages:
            return
        self._loop.call_soon_threadsafe(self._send, json.dumps(status))

    def _send(self, text: str) -> None:
        from websockets.asyncio.server import broadcast

        broadcast(self._pages, text)

    def _take(self, connection: Any, message: str | bytes) -> None:
        if self._robot is None:
            return
        source, share, ask = self._robot
        try:
            said = json.loads(message)
            if "do" in said:
                ask(str(said["do"]))
            elif "release" in said:
                self._release(connection)
            elif self._drives(connection):
                forward, left, turn = (float(value) for value in said["v"])
                if all(-1 <= value <= 1 for value in (forward, left, turn)):
                    source.command(share(forward, left, turn))
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError, HexctlError):
            return

    def _drives(self, connection: Any) -> bool:
        """Whether a page that holds a key now drives."""
        now_s = WALL_TIME.now()
        if self._driver is not connection and now_s - self._driven_at_s <= COMMAND_EXPIRY_S:
            return False
        self._driver, self._driven_at_s = connection, now_s
        return True

    def _release(self, connection: Any) -> None:
        if self._driver is connection and self._robot is not None:
            self._driver, self._driven_at_s = None, 0.0
            self._robot[0].forget()
