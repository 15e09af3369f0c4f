"""Event log of a served robot: changes of controller, stop and posture, as lines for the operator."""

import math
import queue
import threading
import time as wall
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Conditions:
    """Conditions of a robot whose changes are reported.

    Attributes:
        ros: line on the ROS router.
        doubt: line on an implausible position.
        standstill: of this program; it is reported before its consequences.
    """

    controller: str | None = None
    stopped: str | None = None
    posture: str = "idle"
    stop: Stop | None = None
    cleared: Clear | None = None
    fault: str | None = None
    warnings: tuple[str, ...] = ()
    ros: str | None = None
    doubt: str | None = None
    standstill: Standstill | None = None

    @property
    def stop_by(self) -> str | None:
        """Who asked for the stop."""
        return None if self.stop is None else self.stop.by


class EventLog:
    """Reports changes of the robot's controller, stop and posture on a thread, which may block."""

    def __init__(
        self, report: Callable[[str], None], *, clear: str = CLEAR_COMMAND, time: TimeSource = WALL_TIME
    ) -> None:
        """Create a log; `report` takes a line, `clear` is the command that ends a stop."""
        self._report, self._clear, self._time = report, clear, time
        self._lines: queue.Queue[str | None] = queue.Queue(WAITING_LINES)
        self._before = Conditions()
        self._writer: threading.Thread | None = None
        self._dropped = 0

    def note(self, now: Conditions) -> None:
        """Report changes since the last call, and the end of a fault while its stop is latched."""
        before, self._before = self._before, now
        for line in self._changes(before, now):
            self.add(line)

    def _changes(self, before: Conditions, now: Conditions) -> Iterator[str]:
        if now.standstill not in (None, before.standstill):
            yield f"{now.standstill}; {STALL_HELP}"
        for line, known in ((now.doubt, before.doubt), (now.ros, before.ros)):
            if line is not None and line != known:
                yield line
        yield from (f"servos: {warning}" for warning in now.warnings if warning not in before.warnings)
        for warning in before.warnings:
            more_mute = MANY_MUTE in now.warnings and warning.startswith("mute: ")
            if warning not in now.warnings and not more_mute:
                yield f"servos: no longer {warning}"
        # A stop revokes the lease: its controller did not disconnect.
        stops = now.controller is None and now.stopped not in (None, before.stopped)
        if now.controller != before.controller and not stops:
            yield f"commanded by {now.controller}" if now.controller else f"{before.controller} has left"
        yield from self._stop_changes(before, now, before.controller if stops else None)
        if (
            now.stopped is not None
            and now.stopped.startswith("fault:")
            and before.fault
            and now.fault is None
        ):
            yield f"over, and still stopped ({before.fault}): {self._clear} lets the robot move"
        if now.posture != before.posture and now.posture in POSTURES:
            yield POSTURES[now.posture]

    def _stop_changes(self, before: Conditions, now: Conditions, lost: str | None) -> Iterator[str]:
        """Report a latched stop too once its requester is known; `lost` is its former controller."""
        was = before.stopped
        ended = "" if now.cleared in (None, before.cleared) else f"cleared by {now.cleared.by}"
        asked = "" if now.stop_by is None else f", asked for by {now.stop_by}"
        if now.stopped is None:
            if was is not None:
                yield f"no longer stopped ({was}){f', {ended}' if ended else ''}"
            return
        if ended:
            yield f"{ended}{f' ({was})' if was is not None else ''}"
        if now.stopped != was or ended:
            first = "" if was is None or ended else f", after {was}"
            commanded = "" if lost is None else f", commanded by {lost} until then"
            yield f"STOPPED: {self._cause(now, now.stopped)}{asked}{first}{commanded}"
        elif now.stop_by is not None and now.stop_by != before.stop_by:
            yield f"still stopped{asked}"

    def _cause(self, now: Conditions, stopped: str) -> str:
        if now.stop_by and stopped == ESTOP:
            return ESTOP
        ended_s = -math.inf if now.standstill is None else now.standstill.ended_s
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
