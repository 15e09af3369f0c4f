"""Any button of any gamepad as a stop: gamepads may be plugged in and out at any time."""

import os
import time
from collections.abc import Callable
from pathlib import Path

from hexctl.teleop.gamepad import EV_KEY, EVENT, LOOK_S, MOST_BYTES, find_gamepads


class StopButton:
    """Looks whether a button of a gamepad was pressed.

    Args:
        find: finds event files of gamepads.
        now_s: monotonic time.
    """

    def __init__(
        self,
        find: Callable[[], list[Path]] = find_gamepads,
        *,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._find, self._now_s, self._look_at_s = find, now_s, -LOOK_S
        self._open: dict[Path, int] = {}

    @property
    def connected(self) -> int:
        """How many gamepads there are now."""
        return len(self._open)

    def pressed(self) -> bool:
        """Whether a button was pressed since the last look; never waits."""
        self._look()
        return any(self._read(path) for path in list(self._open))

    def close(self) -> None:
        """Let go of the gamepads."""
        for path in list(self._open):
            self._leave(path)

    def _look(self) -> None:
        now_s = self._now_s()
        if now_s - self._look_at_s < LOOK_S:
            return
        self._look_at_s = now_s
        for path in self._find():
            if path in self._open:
                continue
            try:
                self._open[path] = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
            except OSError:
                continue

    def _read(self, path: Path) -> bool:
        """Whether a button is among the events of a gamepad that wait."""
        try:
            data = os.read(self._open[path], MOST_BYTES)
        except BlockingIOError:
            return False
        except OSError:
            data = b""
        if not data:
            self._leave(path)
            return False
        whole = data[: len(data) - len(data) % EVENT.size]
        return any(kind == EV_KEY and value == 1 for _, _, kind, _, value in EVENT.iter_unpack(whole))

    def _leave(self, path: Path) -> None:
        os.close(self._open.pop(path))
