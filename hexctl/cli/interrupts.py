"""Ctrl-C while the program starts: what is being imported is imported first.

Python raises KeyboardInterrupt wherever it is, and an extension module that is cut off half way raises what
comes, or prints tracebacks that nobody can catch. Imports light.
"""

import os
import signal
import sys
from types import FrameType

INTERRUPTED = 130

#: How every stop of a robot that failed ends, also one that was interrupted before it began.
NOT_CONFIRMED = "The robot is NOT confirmed stopped: use the switch of its servos' supply"

#: How soon after an interrupt is asked again whether the import has ended.
AGAIN_S = 0.02


def defer_in_imports() -> None:
    """Let Ctrl-C raise KeyboardInterrupt as Python does, but not before an import has ended.

    A second one does not wait for it: it ends the process. A process that ignores Ctrl-C goes on ignoring it.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGALRM, _interrupt)
        signal.signal(signal.SIGINT, _interrupt)


def raise_deferred() -> None:
    """Raise KeyboardInterrupt where one waits for the end of an import."""
    if signal.setitimer(signal.ITIMER_REAL, 0)[0] > 0:
        raise KeyboardInterrupt


def forget_deferred() -> None:
    """Raise no KeyboardInterrupt any more that waits: the command is over."""
    signal.setitimer(signal.ITIMER_REAL, 0)
    signal.signal(signal.SIGALRM, signal.SIG_IGN)


def importing(frame: FrameType | None) -> bool:
    """Whether a frame, or one that called it, imports a module."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def _interrupt(number: int, frame: FrameType | None) -> None:
    waiting = signal.getitimer(signal.ITIMER_REAL)[0] > 0
    if not importing(frame):
        signal.setitimer(signal.ITIMER_REAL, 0)
        raise KeyboardInterrupt
    if number == signal.SIGINT and waiting:
        os.write(sys.stderr.fileno(), b"hexctl: interrupted\n")
        os._exit(INTERRUPTED)
    signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
