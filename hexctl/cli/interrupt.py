"""Ctrl-C as a request: the first asks for a soft stop, the second ends the program."""

import os
import signal
import sys
from types import FrameType, TracebackType
from typing import Any, Self

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StopOnInterrupt:
    """While open, SIGINT and SIGTERM only set `requested`; a second one raises KeyboardInterrupt."""

    def __init__(self) -> None:
        self._requested = False
        self._before: dict[signal.Signals, Any] = {}

    def requested(self) -> bool:
        """Return whether a stop was asked for."""
        return self._requested

    def __enter__(self) -> Self:
        for number in SIGNALS:
            self._before[number] = signal.signal(number, self._handle)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self._requested:
            raise KeyboardInterrupt
        self._requested = True
        if sys.stderr.isatty():
            os.write(sys.stderr.fileno(), b"\nstopping softly; Ctrl-C again ends at once\n")
