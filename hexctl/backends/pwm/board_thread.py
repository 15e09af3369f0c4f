"""The thread that owns a board: sends the newest pulses at once, and asks for reports in between."""

import threading
import time
from collections.abc import Callable
from dataclasses import replace

from hexctl.backends.pwm.board import BoardReport, PwmBoard, PwmCounters
from hexctl.errors import RobotFaultError
from hexctl.types import FloatArray

#: Reports are asked for once in this time, after the pulses of the tick if there are any.
POLL_PERIOD_S = 0.02

#: How often it is tried to open a port that has gone.
REOPEN_PERIOD_S = 0.25


class BoardThread:
    """Runs a board between `start` and `stop`; its methods never wait for the port, `stop` apart.

    Args:
        opened: opens the board again, when its port has gone and may be back.
        board: open.
        newest: what it has told.
        counters: of the board.

    Attributes:
        gone: why the port cannot be used at this moment, or None.
        newest: last report.
    """

    def __init__(
        self, opened: Callable[[], PwmBoard], board: PwmBoard, newest: BoardReport, counters: PwmCounters
    ) -> None:
        self._open, self._board, self._counters = opened, board, counters
        self._lock, self._wake = threading.Lock(), threading.Event()
        self._pulses: FloatArray | None = None
        self._release = self._on = self._stopping = False
        self.gone: str | None = None
        self.newest = newest
        self._thread = threading.Thread(target=self._run, name="servo board", daemon=True)

    def start(self) -> None:
        """Begin; nothing is powered."""
        self._thread.start()

    def stop(self) -> None:
        """Send what is left, and close the board, whose servos keep their pulses."""
        self._stopping = True
        self._wake.set()
        self._thread.join()

    def send(self, pulses_us: FloatArray) -> None:
        """Leave pulses of each joint, (18,), in place of any that have not been sent."""
        with self._lock:
            self._pulses = pulses_us
        self._wake.set()

    def release(self) -> None:
        """Let the servos go limp; pulses that have not been sent are dropped."""
        with self._lock:
            self._pulses, self._release = None, True
        self._wake.set()

    def _run(self) -> None:
        due_s = time.monotonic()
        while not self._stopping:
            self._wake.wait(max(0.0, due_s - time.monotonic()))
            self._wake.clear()
            try:
                if self._tell() or time.monotonic() >= due_s:
                    due_s = time.monotonic() + POLL_PERIOD_S
                    self._hear(self._board.poll())
            except OSError as error:
                self._reopen(error)
                due_s = time.monotonic()
        if self.gone is None:
            self._end()

    def _tell(self) -> bool:
        """Send what was left; whether that was anything."""
        with self._lock:
            pulses, self._pulses = self._pulses, None
            release, self._release = self._release, False
        if release:
            self._board.end()
            self._on = False
            self.newest = replace(self.newest, fault=None)
        if pulses is None or self.newest.fault is not None:
            return release
        if self._on:
            self._board.write(pulses)
        else:
            self._board.begin(pulses)
            self._on = True
        self._counters.writes += 1
        return True

    def _hear(self, report: BoardReport | None) -> None:
        if report is None:
            self._counters.missed += 1
            return
        self._counters.reports += 1
        self.newest = report
        if report.fault is not None:
            self._on = False

    def _reopen(self, error: OSError) -> None:
        """Wait until the port is back; the pose is staged anew before anything is powered."""
        self.gone = error.strerror or str(error)
        self._board.close()
        while not self._stopping:
            self._wake.wait(REOPEN_PERIOD_S)
            self._wake.clear()
            try:
                self._board = self._open()
            except (OSError, RobotFaultError):
                continue
            with self._lock:
                self._pulses, self._release = None, False
            self._on = False
            self._counters.reopened += 1
            self.gone = None
            return

    def _end(self) -> None:
        try:
            self._tell()
        except OSError as error:
            self.gone = error.strerror or str(error)
        self._board.close()
