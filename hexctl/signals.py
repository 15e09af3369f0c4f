"""Signals that end a process. Commands bring their robot to rest first."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

#: Signals that always request a stop, even if a shell made a background process ignore them.
ASKED = (signal.SIGINT, signal.SIGTERM)

#: Signals that cannot be handled, that end no process, or that report a broken process.
_OTHERS = (
    *("SIGKILL", "SIGSTOP"),
    *("SIGCHLD", "SIGCONT", "SIGTSTP", "SIGTTIN", "SIGTTOU", "SIGURG", "SIGWINCH", "SIGINFO"),
    *("SIGABRT", "SIGBUS", "SIGFPE", "SIGILL", "SIGSEGV", "SIGSYS", "SIGTRAP", "SIGEMT"),
)


def ending_signals() -> tuple[int, ...]:
    """Return all signals that would end this process and that it does not ignore, ascending.

    SIGHUP, of a closed terminal, is ignored under `nohup`; Python ignores SIGPIPE and SIGXFSZ.
    """
    ends = signal.valid_signals() - {getattr(signal, name, None) for name in _OTHERS}
    return tuple(sorted(one for one in ends if one in ASKED or not _ignored(one)))


def _ignored(number: int) -> bool:
    """Whether a signal is ignored, or has a handler outside of Python."""
    return signal.getsignal(number) in (signal.SIG_IGN, None)


@contextmanager
def handled_by(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Handle all signals that would end this process, until the block ends."""
    before = {number: signal.signal(number, handler) for number in ending_signals()}
    try:
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)
