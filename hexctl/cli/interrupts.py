"""Defers Ctrl-C during imports, which it may break with uncatchable tracebacks. Imports light."""

import os
import signal
import sys
from collections.abc import Sequence
from types import FrameType
from typing import NoReturn

INTERRUPTED = 130

#: Last sentence of every stop of a robot that failed or was interrupted.
NOT_CONFIRMED = "The robot is NOT confirmed stopped: use the switch of its servos' supply"

#: Interval at which a deferred interrupt checks whether the import has ended.
AGAIN_S = 0.02


#: Deferred interrupts: the timer may have expired on a busy computer before the next one comes.
_deferred: list[int] = []


def not_begun(arguments: Sequence[str]) -> str:
    """Text about an interrupt before the command of some arguments began."""
    left = f". {NOT_CONFIRMED}" if arguments[:1] == ["estop"] else ": nothing was done"
    return f"interrupted before the command began{left}"


def defer_in_imports() -> None:
    """Let Ctrl-C raise KeyboardInterrupt after the end of an import.

    A second one ends the process immediately. A process that ignores Ctrl-C continues to do so.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGALRM, _interrupt)
        signal.signal(signal.SIGINT, _interrupt)


def raise_deferred() -> None:
    """Raise a deferred KeyboardInterrupt."""
    defers = signal.getsignal(signal.SIGALRM) is _interrupt
    if defers and _deferred:
        _raise()


def forget_deferred() -> None:
    """Drop a deferred KeyboardInterrupt: the command is over."""
    signal.setitimer(signal.ITIMER_REAL, 0)
    signal.signal(signal.SIGALRM, signal.SIG_IGN)
    _deferred.clear()


def importing(frame: FrameType | None) -> bool:
    """Whether a frame, or one of its callers, imports a module."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def _interrupt(number: int, frame: FrameType | None) -> None:
    if not importing(frame):
        _raise()
    if number == signal.SIGINT and _deferred:
        os.write(sys.stderr.fileno(), b"hexctl: interrupted\n")
        os._exit(INTERRUPTED)
    _deferred[:] = [number]
    signal.setitimer(signal.ITIMER_REAL, AGAIN_S)


def _raise() -> NoReturn:
    signal.setitimer(signal.ITIMER_REAL, 0)
    _deferred.clear()
    raise KeyboardInterrupt
