"""Waiting for a condition, or for a descriptor, with a timeout."""

import select
from collections.abc import Callable
from typing import TypeVar

from hexctl.errors import RobotFaultError
from hexctl.time_source import WALL_TIME, TimeSource

Value = TypeVar("Value")

#: Asked again and again by something that takes long; True ends it.
StopRequested = Callable[[], bool]

#: Pause between two tests of a condition.
POLL_S = 0.01

#: Limit of descriptors for `select`.
SELECTABLE = 1024


def never_stop() -> bool:
    """Request no stop."""
    return False


def comes_true(
    condition: Callable[[], bool], timeout_s: float, *, poll_s: float = POLL_S, time: TimeSource = WALL_TIME
) -> bool:
    """Whether a condition comes true in time; it is tested at least once and then every `poll_s`."""
    return _first_true(condition, timeout_s, poll_s, time) is not None


def wait_for(
    condition: Callable[[], Value | None],
    timeout_s: float,
    message: str | Callable[[], str],
    *,
    poll_s: float = POLL_S,
    time: TimeSource = WALL_TIME,
) -> Value:
    """First true value of a condition, which is tested at least once and then every `poll_s`.

    Raises RobotFaultError with the message after the timeout, and what the condition raises.
    """
    value = _first_true(condition, timeout_s, poll_s, time)
    if value is None:
        raise RobotFaultError(message if isinstance(message, str) else message())
    return value


def _first_true(
    condition: Callable[[], Value | None], timeout_s: float, poll_s: float, time: TimeSource
) -> Value | None:
    deadline_s = time.now() + timeout_s
    while not (value := condition()):
        if time.now() >= deadline_s:
            return None
        time.sleep(poll_s)
    return value


def wait_ready(descriptor: int, timeout_s: float, *, to_write: bool = False) -> bool:
    """Wait until a descriptor is readable or writable; return whether it was in time.

    `select` accepts no descriptor from 1024 on; `poll` counts in whole ms, and a bus needs shorter waits.
    """
    if descriptor >= SELECTABLE:
        poll = select.poll()
        poll.register(descriptor, select.POLLOUT if to_write else select.POLLIN)
        return bool(poll.poll(1000.0 * timeout_s))
    this: list[int] = [descriptor]
    readable, writable, _ = select.select(*([], this) if to_write else (this, []), [], timeout_s)
    return bool(readable or writable)
