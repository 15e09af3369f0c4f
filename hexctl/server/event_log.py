"""Event log of a served robot: changes of controller, stop and posture, as lines for the operator."""

import math
import queue
import threading
import time as wall
from collections.abc import Callable
from contextlib import suppress

from hexctl.backends.bus.servo_bus import MANY_MUTE
from hexctl.backends.clock import Standstill
from hexctl.control.stop_reason import reason_in_words
from hexctl.time_source import WALL_TIME, TimeSource
from hexctl.wire.links import CLEAR_COMMAND
from hexctl.wire.stop import ESTOP, Clear, Stop

#: Lines that wait for a slow reader; further ones are dropped and counted.
WAITING_LINES = 256

#: How long `close` waits for the last lines to be read.
END_TIMEOUT_S = 0.5

STALL_HELP = "close other programs on this computer, or use a faster one"

#: A stop for silence this soon after a standstill of this program is attributed to it.
CAUSED_WITHIN_S = 1.0

#: Reasons to stop that a standstill of this program causes.
SILENCES = ("expired", "state", "pose lost")

#: Lines for postures; `commanded` has none, because its controller is reported.
POSTURES = {
    "holding": "holds its pose",
    "sitting": "sits down: commands have stopped",
    "limp": "sits, joints limp",
    "unreached": "its servos cannot be reached: what they do is not known",
}


class EventLog:
    """Reports changes of the robot's controller, stop and posture on a thread, which may block."""

    def __init__(
        self, report: Callable[[str], None], *, clear: str = CLEAR_COMMAND, time: TimeSource = WALL_TIME
    ) -> None:
        """Create a log; `report` takes a line, `clear` is the command that ends a stop."""
        self._report, self._clear, self._time = report, clear, time
        self._lines: queue.Queue[str | None] = queue.Queue(WAITING_LINES)
        self._controller: str | None = None
        self._stopped: str | None = None
        self._stop_by: str | None = None
        self._cleared: Clear | None = None
        self._posture = "idle"
        self._fault: str | None = None
        self._writer: threading.Thread | None = None
        self._dropped = 0
        self._warnings: tuple[str, ...] = ()
        self._ros: str | None = None
        self._doubt: str | None = None
        self._standstill: Standstill | None = None

    def note(
        self,
        *,
        controller: str | None,
        stopped: str | None,
        posture: str,
        stop: Stop | None = None,
        cleared: Clear | None = None,
        fault: str | None = None,
        warnings: tuple[str, ...] = (),
        ros: str | None = None,
        doubt: str | None = None,
        standstill: Standstill | None = None,
    ) -> None:
        """Report changes since the last call, and the end of a fault while its stop is latched.

        `ros` and `doubt` are lines on the ROS router and on an implausible position. A standstill of this
        program is reported before its consequences.
        """
        if standstill is not None and standstill != self._standstill:
            self.add(f"{standstill}; {STALL_HELP}")
        self._standstill = standstill
        if doubt is not None and doubt != self._doubt:
            self.add(doubt)
        self._doubt = doubt
        if ros is not None and ros != self._ros:
            self.add(ros)
        self._ros = ros
        for warning in warnings:
            if warning not in self._warnings:
                self.add(f"servos: {warning}")
        for warning in self._warnings:
            more_mute = MANY_MUTE in warnings and warning.startswith("mute: ")
            if warning not in warnings and not more_mute:
                self.add(f"servos: no longer {warning}")
        self._warnings = warnings
        # A stop revokes the lease: its controller did not disconnect.
        lost = self._controller if controller is None and stopped not in (None, self._stopped) else None
        if controller != self._controller and lost is None:
            self.add(f"commanded by {controller}" if controller else f"{self._controller} has left")
        self._note_stop(stopped, None if stop is None else stop.by, cleared, lost)
        if stopped is not None and stopped.startswith("fault:") and self._fault and fault is None:
            self.add(f"over, and still stopped ({self._fault}): {self._clear} lets the robot move")
        self._fault = fault
        if posture != self._posture and posture in POSTURES:
            self.add(POSTURES[posture])
        self._controller, self._posture = controller, posture

    def _note_stop(
        self, stopped: str | None, by: str | None, cleared: Clear | None, lost: str | None
    ) -> None:
        """Report a latched stop too once its requester is known; `lost` is its former controller."""
        ended = None if cleared is None or cleared == self._cleared else f"cleared by {cleared.by}"
        before, before_by = self._stopped, self._stop_by
        self._stopped, self._stop_by, self._cleared = stopped, by, cleared
        asked = "" if by is None else f", asked for by {by}"
        if stopped is None:
            if before is not None:
                self.add(f"no longer stopped ({before}){f', {ended}' if ended else ''}")
            return
        if ended:
            self.add(f"{ended}{f' ({before})' if before is not None else ''}")
        if stopped != before or ended:
            first = "" if before is None or ended else f", after {before}"
            commanded = "" if lost is None else f", commanded by {lost} until then"
            self.add(f"STOPPED: {self._cause(stopped, by)}{asked}{first}{commanded}")
        elif by is not None and by != before_by:
            self.add(f"still stopped{asked}")

    def _cause(self, stopped: str, by: str | None) -> str:
        if by and stopped == ESTOP:
            return ESTOP
        ended_s = -math.inf if self._standstill is None else self._standstill.ended_s
        if stopped in SILENCES and self._time.now() - ended_s < CAUSED_WITHIN_S:
            return f"{stopped} (because this program stood still)"
        return reason_in_words(stopped)

    def close(self) -> None:
        """Report the waiting lines, unless the reader is too slow."""
        if self._writer is not None:
            with suppress(queue.Full):
                self._lines.put_nowait(None)
            self._writer.join(END_TIMEOUT_S)

    def add(self, event: str) -> None:
        """Queue one line; never waits."""
        if self._writer is None:
            self._writer = threading.Thread(target=self._write, name="event log", daemon=True)
            self._writer.start()
        before = f" ({self._dropped} lines dropped)" if self._dropped else ""
        try:
            self._lines.put_nowait(f"{wall.strftime('%H:%M:%S')}{before} {event}")
            self._dropped = 0
        except queue.Full:
            self._dropped += 1

    def _write(self) -> None:
        while (line := self._lines.get()) is not None:
            try:
                self._report(line)
            except OSError:
                return  # the reader has closed its end
