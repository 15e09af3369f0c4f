"""Any button of any gamepad or joystick as a stop: gamepads may be plugged in and out at any time."""

import time
from collections.abc import Callable
from pathlib import Path

from hexctl.teleop.event_file import EV_KEY, EventFiles
from hexctl.teleop.gamepad import find_stop_pads


class StopButton:
    """Detects presses of any button of any gamepad or joystick."""

    def __init__(
        self,
        find: Callable[[], list[Path]] = find_stop_pads,
        *,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._files = EventFiles(find, now_s=now_s)

    @property
    def connected(self) -> int:
        """Number of gamepads."""
        return len(self._files.opened)

    def pressed(self) -> bool:
        """Whether a button was pressed since the last call; never waits."""
        self._files.look()
        presses = [kind == EV_KEY and value == 1 for kind, _, value in self._files.events()]
        return any(presses)

    def close(self) -> None:
        """Close the gamepads."""
        self._files.close()
