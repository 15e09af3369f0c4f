"""Event log of a served robot: changes of controller, stop and posture, as lines for the operator."""

import math
import queue
import threading
import time as wall
from collections.abc import Callable, Iterator
from contextlib import suppress

import numpy as np

from hexctl.backends.bus.servo_bus import MANY_MUTE
from hexctl.backends.clock import Standstill
from hexctl.control.stop_reason import reason_in_words
from hexctl.server.snapshot import RobotSnapshot
from hexctl.time_source import WALL_TIME, TimeSource
from hexctl.types import N_JOINTS, RobotState
from hexctl.wire.links import CLEAR_COMMAND
from hexctl.wire.stop import ESTOP, Stop

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


#: A robot of which nothing is known yet.
UNKNOWN = RobotSnapshot(state=RobotState(np.zeros(N_JOINTS), 0.0, measured=False))


class EventLog:
    """Reports changes of the robot's controller, stop and posture on a thread, which may block."""

    def __init__(
        self, report: Callable[[str], None], *, clear: str = CLEAR_COMMAND, time: TimeSource = WALL_TIME
    ) -> None:
        """Create a log; `report` takes a line, `clear` is the command that ends a stop."""
        self._report, self._clear, self._time = report, clear, time
        self._lines: queue.Queue[str | None] = queue.Queue(WAITING_LINES)
        self._before = UNKNOWN
        self._writer: threading.Thread | None = None
        self._dropped = 0

    def note(self, now: RobotSnapshot) -> None:
        """Report changes since the last call, and the end of a fault while its stop is latched."""
        before, self._before = self._before, now
        for line in self._changes(before, now):
            self.add(line)

    def _changes(self, before: RobotSnapshot, now: RobotSnapshot) -> Iterator[str]:
        if now.standstill not in (None, before.standstill):
            yield f"{now.standstill}; {STALL_HELP}"
        warnings, warned = now.state.warnings, before.state.warnings
        for line, known in ((now.doubt, before.doubt), (now.ros, before.ros)):
            if line is not None and line != known:
                yield line
        yield from (f"servos: {warning}" for warning in warnings if warning not in warned)
        for warning in warned:
            more_mute = MANY_MUTE in warnings and warning.startswith("mute: ")
            if warning not in warnings and not more_mute:
                yield f"servos: no longer {warning}"
        # A stop revokes the lease: its controller did not disconnect.
        stops = now.controller is None and now.stopped not in (None, before.stopped)
        if now.controller != before.controller and not stops:
            yield f"commanded by {now.controller}" if now.controller else f"{before.controller} has left"
        yield from self._stop_changes(before, now, before.controller if stops else None)
        faulted = now.stopped is not None and now.stopped.startswith("fault:")
        if faulted and before.state.fault and now.state.fault is None:
            yield f"over, and still stopped ({before.state.fault}): {self._clear} lets the robot move"
        if now.posture != before.posture and now.posture in POSTURES:
            yield POSTURES[now.posture]

    def _stop_changes(self, before: RobotSnapshot, now: RobotSnapshot, lost: str | None) -> Iterator[str]:
        """Report a latched stop too once its requester is known; `lost` is its former controller."""
        was = before.stopped
        ended = "" if now.cleared in (None, before.cleared) else f"cleared by {now.cleared.by}"
        if now.stop is None:
            if was is not None:
                yield f"no longer stopped ({was}){f', {ended}' if ended else ''}"
            return
        asked = "" if now.stop.by is None else f", asked for by {now.stop.by}"
        if ended:
            yield f"{ended}{f' ({was})' if was is not None else ''}"
        if now.stopped != was or ended:
            first = "" if was is None or ended else f", after {was}"
            commanded = "" if lost is None else f", commanded by {lost} until then"
            yield f"STOPPED: {self._cause(now.stop, now.standstill)}{asked}{first}{commanded}"
        elif asked and before.stop is not None and now.stop.by != before.stop.by:
            yield f"still stopped{asked}"

    def _cause(self, stop: Stop, standstill: Standstill | None) -> str:
        if stop.by and stop.reason == ESTOP:
            return ESTOP
        ended_s = -math.inf if standstill is None else standstill.ended_s
        if stop.reason in SILENCES and self._time.now() - ended_s < CAUSED_WITHIN_S:
            return f"{stop.reason} (because this program stood still)"
        return reason_in_words(stop.reason)

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
