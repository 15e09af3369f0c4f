"""The thread that owns a port: sends the newest targets, polls in between, and reopens a lost port."""

import contextlib
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from hexctl.backends.clock import PERIOD_S, request_realtime_priority
from hexctl.errors import HexctlError
from hexctl.robot.plugins import custom_failure, show_traceback
from hexctl.time_source import WALL_TIME, TimeSource
from hexctl.types import FloatArray

#: Period of polls of the port, after the targets of the tick.
POLL_PERIOD_S = 0.02

#: Interval of attempts to reopen a lost port.
REOPEN_PERIOD_S = 0.25


class OnPort(Protocol):
    """Device on an open port, used by one thread."""

    def close(self) -> None:
        """Close the port."""


@dataclass(slots=True, kw_only=True)
class PortCounters:
    """Counts of a port since it was opened first; `missed` are requested reports that did not arrive."""

    reopened: int = 0
    writes: int = 0
    reports: int = 0
    missed: int = 0


Device = TypeVar("Device", bound=OnPort)


class PortThread(ABC, Generic[Device]):
    """Runs a device on a port; only `stop` waits for the port.

    After any error the port is closed and reopened until that succeeds, and targets of that time are dropped.
    A request to switch the torque off is kept until it succeeds, or until new targets come.

    Args:
        opened: reopens the port.
        speeds: maximum of the joints, (18,), in the units of the port per second. Targets move at most as far
            as joints turn in the time since the last packet, up to a control period: a delayed port must not
            jump.

    Attributes:
        gone: why the port cannot be used now, or None.
        on: whether the servos hold.
    """

    def __init__(
        self,
        opened: Callable[[], Device],
        device: Device,
        *,
        counters: PortCounters,
        speeds: FloatArray,
        name: str,
        time: TimeSource = WALL_TIME,
    ) -> None:
        self._time, self._open, self._device = time, opened, device
        self._port_counters, self._steps = counters, PERIOD_S * speeds
        self._allowance, self._stepped_at_s = np.ones(len(speeds)), self._time.now()
        self._lock, self._wake, self._stopping = threading.Lock(), threading.Event(), threading.Event()
        self._targets: FloatArray | None = None
        self._sent: FloatArray | None = None
        self._release = False  # whether torque still has to be switched off
        self.on = self._ended = False
        self._ending = threading.Lock()
        self.gone: str | None = None
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Start to follow targets."""
        self._thread.start()

    def stop(self) -> None:
        """Stop after the current packets; the servos hold, unless their torque was to be off."""
        self._stopping.set()
        self._wake.set()
        if self._thread.ident is not None:
            self._time.join(self._thread)
        self._end()  # if connecting was interrupted, perhaps while the thread began

    def send(self, targets: FloatArray) -> None:
        """Set the next targets, (18,) in the units of the port."""
        with self._lock:
            self._targets = targets
            self._release = self._release and self._must_release()
        self._wake.set()

    def release(self) -> None:
        """Switch the torque off; unsent targets are dropped."""
        with self._lock:
            self._targets, self._release = None, True
        self._wake.set()

    @abstractmethod
    def _follow(self, targets: FloatArray) -> FloatArray:
        """Send targets, (18,), or the possible part; the result is what was sent, the rest follows."""

    @abstractmethod
    def _let_go(self) -> None:
        """Switch the torque off."""

    @abstractmethod
    def _poll(self) -> None:
        """Ask for reports, and keep them."""

    def _may_follow(self) -> bool:
        """Whether targets may be sent; else they are dropped."""
        return True

    def _must_release(self) -> bool:
        """Whether the torque must be off for a moment although new targets have come."""
        return False

    def _meet(self) -> None:
        """Read the state of a reopened port; may raise any error of a port."""

    def _finish(self) -> None:
        """Do the last steps before the port is closed."""

    def _stepped(self, targets: FloatArray) -> FloatArray:
        """Limit targets to the motion since the last packet, up to a period; joints never sent are free."""
        now_s = self._time.now()
        allowed = np.minimum(1.0, self._allowance + (now_s - self._stepped_at_s) / PERIOD_S)
        self._allowance, self._stepped_at_s = allowed, now_s
        if self._sent is None:
            return targets
        wanted = targets - self._sent
        change = np.clip(wanted, -allowed * self._steps, allowed * self._steps)
        self._allowance = allowed - np.abs(np.nan_to_num(change)) / self._steps
        # A target in reach is taken as it is: a sum would be off by its rounding, and never be there.
        return np.where(np.isnan(change) | (change == wanted), targets, self._sent + change)

    def _run(self) -> None:
        request_realtime_priority()  # threads do not inherit it, and a tick is worth what reaches the port
        due_s = self._time.now()
        while not self._stopping.is_set():
            self._time.wait(self._wake, max(0.0, due_s - self._time.now()))
            self._wake.clear()
            try:
                if self._write() or self._time.now() >= due_s:
                    due_s = self._time.now() + POLL_PERIOD_S
                    self._poll()
            except Exception as error:  # noqa: BLE001  any error must stop the robot
                self._reopen(error)
                due_s = self._time.now()
        self._end()

    def _write(self) -> bool:
        """Send pending targets or torque off; whether there was any."""
        with self._lock:
            release = self._release
            targets, self._targets = (None, self._targets) if release else (self._targets, None)
        if release:
            self._let_go()
            self.on, self._sent = False, None
            with self._lock:  # only now it is done
                self._release = False
            return True
        if targets is None or not self._may_follow():
            return False
        self._sent = self._follow(targets)
        self.on = True
        if (self._sent != targets).any():
            with self._lock:
                if self._targets is None and not self._release:
                    self._targets = targets
        return True

    def _reopen(self, error: Exception) -> None:
        """Wait until the port is back, and start again: the servos hold, or have lost their power."""
        self.gone = reason_of(error)
        with contextlib.suppress(Exception):
            self._device.close()
        while not self._time.wait(self._stopping, REOPEN_PERIOD_S):
            if self._is_back():
                self._port_counters.reopened += 1
                with self._lock:  # those that came while it was opened were meant for a robot that had gone
                    self._targets, self.gone = None, None
                return

    def _is_back(self) -> bool:
        try:
            self._device = self._open()
        except Exception:  # noqa: BLE001  it is as gone as before
            return False
        self.on, self._sent = False, None
        try:
            self._meet()
        except Exception:  # noqa: BLE001
            with contextlib.suppress(Exception):
                self._device.close()
            return False
        return True

    def _end(self) -> None:
        with self._ending:
            if self._ended or self.gone is not None:
                return
            self._ended = True
            try:
                if self._release:
                    self._let_go()
                self._finish()
            except Exception as error:  # noqa: BLE001  no caller is left
                self.gone = reason_of(error)
            with contextlib.suppress(Exception):
                self._device.close()


def reason_of(error: Exception) -> str:
    """An error in few words; one of custom code names it."""
    show_traceback(error)
    custom = None if isinstance(error, OSError | HexctlError) else custom_failure(error)
    return custom or getattr(error, "strerror", None) or str(error) or type(error).__name__
