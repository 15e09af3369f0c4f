"""What changes on a robot that is served, told to a person in words."""

import queue
import threading
import time
from collections.abc import Callable
from contextlib import suppress

#: Lines that wait for a slow reader; what comes after them is left out, and counted.
WAITING_LINES = 256

#: How long the last lines may take to be read.
END_PATIENCE_S = 0.5

#: What a posture means; `commanded` needs no line, its controller has one.
POSTURES = {
    "holding": "holds its pose",
    "sitting": "sits down: no commands any more",
    "limp": "sits, joints limp",
}


class EventLog:
    """Tells who commands the robot, what stopped it and how it stands, whenever that changes.

    Lines are written by a thread of their own: a terminal that somebody holds must not hold up the robot.
    """

    def __init__(self, report: Callable[[str], None]) -> None:
        self._report = report
        self._lines: queue.Queue[str | None] = queue.Queue(WAITING_LINES)
        self._controller: str | None = None
        self._stopped: str | None = None
        self._posture = "idle"
        self._writer: threading.Thread | None = None
        self._left_out = 0

    def note(self, *, controller: str | None, stopped: str | None, posture: str) -> None:
        """Tell what is not as it was when this was last called."""
        if controller != self._controller:
            self._put(f"commanded by {controller}" if controller else f"{self._controller} has left")
        if stopped != self._stopped:
            self._put(f"STOPPED: {stopped}" if stopped else f"no longer stopped ({self._stopped})")
        if posture != self._posture and posture in POSTURES:
            self._put(POSTURES[posture])
        self._controller, self._stopped, self._posture = controller, stopped, posture

    def close(self) -> None:
        """Let what waits be told, as long as the reader takes it soon."""
        if self._writer is not None:
            with suppress(queue.Full):
                self._lines.put_nowait(None)
            self._writer.join(END_PATIENCE_S)

    def _put(self, what: str) -> None:
        if self._writer is None:
            self._writer = threading.Thread(target=self._write, name="journal", daemon=True)
            self._writer.start()
        before = f" ({self._left_out} lines left out)" if self._left_out else ""
        try:
            self._lines.put_nowait(f"{time.strftime('%H:%M:%S')}{before} {what}")
            self._left_out = 0
        except queue.Full:
            self._left_out += 1

    def _write(self) -> None:
        while (line := self._lines.get()) is not None:
            try:
                self._report(line)
            except OSError:
                return  # whoever read it has gone
