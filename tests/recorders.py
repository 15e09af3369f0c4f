"""Recorders for tests."""

from collections.abc import Callable

from hexctl.control.log import TickLog


class Calling:
    """A recorder that calls a function with each block."""

    def __init__(
        self, function: Callable[[TickLog, int, int], object], block_ticks: int | None = None
    ) -> None:
        self._function = function
        self.block_ticks = block_ticks

    def write_block(self, log: TickLog, start: int, stop: int) -> None:
        self._function(log, start, stop)
