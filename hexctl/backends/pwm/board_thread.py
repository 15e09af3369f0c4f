"""The thread that owns a board of hobby servos."""

from collections.abc import Callable
from dataclasses import replace

from hexctl.backends.port_thread import STEP_S, PortThread
from hexctl.backends.pwm.board import BoardReport, PwmBoard, PwmCounters
from hexctl.types import FloatArray


class BoardThread(PortThread[PwmBoard]):
    """Runs a board, whose servos turn to the first pulses from wherever they are.

    Args:
        opened: opens the board again, when its port has gone and may be back.
        board: open.
        newest: what it has told.
        counters: of the board.
        speeds: greatest of the joints, (18,), in microseconds of pulse per second.

    Attributes:
        newest: last report.
    """

    def __init__(
        self,
        opened: Callable[[], PwmBoard],
        board: PwmBoard,
        newest: BoardReport,
        counters: PwmCounters,
        speeds: FloatArray,
    ) -> None:
        super().__init__(opened, board, counters=counters, steps=STEP_S * speeds, name="servo board")
        self._counters = counters
        self.newest = newest

    def _may_follow(self) -> bool:
        return self.newest.fault is None

    def _must_release(self) -> bool:
        """A board that has tripped is armed by it."""
        return self.newest.fault is not None

    def _follow(self, targets: FloatArray) -> FloatArray:
        near = self._stepped(targets)
        if self.on:
            self._device.write(near)
        else:
            self._device.begin(near)
        self._counters.writes += 1
        return near

    def _let_go(self) -> None:
        self._device.end()
        self.newest = replace(self.newest, fault=None)

    def _poll(self) -> None:
        report = self._device.poll()
        if report is None:
            self._counters.missed += 1
            return
        self._counters.reports += 1
        self.newest = report
        if report.fault is not None:
            self.on, self._sent = False, None

    def _finish(self) -> None:
        """Send the pose that was left last: the servos are to keep it."""
        targets = self._targets
        while targets is not None and self._may_follow():
            self._sent = self._follow(targets)
            self.on = True
            if (self._sent == targets).all():
                return
