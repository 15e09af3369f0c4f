"""The thread that owns a bus: sends the newest goals, and polls reports in between."""

import threading
import time
from collections.abc import Callable, Sequence

import numpy as np

from hexctl.backends.bus.readings import BelievedReadings
from hexctl.backends.bus.servo_bus import BusCounters, Report, ServoBus
from hexctl.errors import RobotFaultError
from hexctl.types import BoolArray, FloatArray, ServoReadings

#: Reports are polled once in this time, after the goals of the tick if there are any.
POLL_PERIOD_S = 0.02

#: Goals move no farther in a packet than joints turn in this time: a bus that was held up must not jump.
STEP_S = 0.03

#: After a gap this long between its packets the servos' own watchdog may have expired.
GAP_S = 0.15

#: How often it is tried to open a port that has gone.
REOPEN_PERIOD_S = 0.25


class BusThread:
    """Runs a bus between `start` and `stop`.

    Its methods leave or take something, and never wait for the bus.

    Args:
        opened: makes the bus again, when the port has gone and may be back.
        bus: found and prepared.
        readings: that are kept.
        counters: of the bus.
        speeds: greatest of the joints, (18,), in counts per second.

    Attributes:
        gone: why the port cannot be used at this moment, or None.
        on: whether the servos hold.
        limp: joints whose servos were to hold and do not, (18,).
    """

    def __init__(
        self,
        opened: Callable[[], ServoBus],
        bus: ServoBus,
        readings: BelievedReadings,
        counters: BusCounters,
        speeds: FloatArray,
    ) -> None:
        self._open, self._bus, self._readings, self._counters = opened, bus, readings, counters
        self._step = STEP_S * speeds
        self._lock, self._wake = threading.Lock(), threading.Event()
        self._goals: FloatArray | None = None
        self._sent: FloatArray | None = None
        self._release = False  # torque that is to be switched off and is not yet
        self._asked = 0  # joint whose torque was read last
        self._active_at_s = -np.inf
        self._stopping = False
        self.on = False
        self.limp: BoolArray = np.zeros(len(speeds), dtype=bool)
        self.gone: str | None = None
        self._thread = threading.Thread(target=self._run, name="servo bus", daemon=True)

    def start(self, *, on: bool) -> None:
        """Begin; `on` says whether all servos hold already."""
        self.on = on
        self._thread.start()

    def stop(self) -> None:
        """End after the packet that is on the line; the servos hold, but for a torque that was to be off."""
        self._stopping = True
        self._wake.set()
        self._thread.join()

    def send(self, counts: FloatArray) -> None:
        """Leave goals, (18,) in counts, in place of any that have not been sent."""
        with self._lock:
            self._goals, self._release = counts, False
        self._wake.set()

    def release(self) -> None:
        """Let the torque be switched off; goals that have not been sent are dropped."""
        with self._lock:
            self._goals, self._release = None, True
        self._wake.set()

    def newest(self) -> tuple[FloatArray, ServoReadings, float]:
        """Newest positions in counts, what the servos report, and the age of the newest report in s."""
        with self._lock:
            now_s = time.monotonic()
            readings = self._readings
            return readings.positions.copy(), readings.servos(now_s), now_s - readings.newest_at_s

    def _run(self) -> None:
        due_s = time.monotonic()
        while not self._stopping:
            self._wake.wait(max(0.0, due_s - time.monotonic()))
            self._wake.clear()
            try:
                wrote = self._write()
                if wrote or time.monotonic() >= due_s:
                    due_s = time.monotonic() + POLL_PERIOD_S
                    self._take(self._bus.poll(lambda: self._goals is not None))
                    self._check_torque()
                    self._active_at_s = time.monotonic()
            except Exception as error:  # noqa: BLE001  whatever it is, the robot must be told to stop
                self._reopen(error)
                due_s = time.monotonic()
        self._end()

    def _write(self) -> bool:
        """Send what was left; whether that was anything."""
        with self._lock:
            goals, self._goals = self._goals, None
            release = self._release
        if release:
            self._bus.set_torque(False)
            self.on, self._sent = False, None
            self.limp[:] = False
            with self._lock:  # only now it is done
                self._release = False
            return True
        if goals is None:
            return False
        if not self.on:
            self._hold_where_it_is()
        elif time.monotonic() - self._active_at_s > GAP_S:
            self._bus.renew_watchdog()
        near = goals
        if self._sent is not None:
            near = self._sent + np.clip(goals - self._sent, -self._step, self._step)
            near = np.where(np.isnan(near), goals, near)
        self._bus.write_goals(near)
        self._sent = near
        if (near != goals).any():  # the rest follows in the next period
            with self._lock:
                self._goals = goals if self._goals is None else self._goals
        return True

    def _hold_where_it_is(self) -> None:
        """Switch the torque on with each goal where its joint is now, so that nothing jumps."""
        with self._lock:
            self._readings.distrust()
        self._take(self._bus.poll_all())
        with self._lock:
            here = self._readings.positions.copy()
        known: BoolArray = np.isfinite(here) & (self._readings.heard_at_s > time.monotonic() - 1.0)
        self.limp = known & ~self._bus.hold(np.where(known, here, 0.0), known)
        self.on, self._sent = True, np.where(known, here, np.nan)

    def _check_torque(self) -> None:
        """Ask one joint after the other whether it still holds: servos trip, and restart without torque."""
        if not self.on or self._bus.reports_limp:
            return
        self._asked = (self._asked + 1) % len(self.limp)
        torque = self._bus.torque(self._asked, tries=1)
        if torque is not None:
            self.limp[self._asked] = not torque

    def _take(self, reports: Sequence[Report]) -> None:
        with self._lock:
            self._readings.take(reports)
            self._counters.implausible = self._readings.implausible

    def _reopen(self, error: Exception) -> None:
        """Wait until the port is back, and begin as at first: the servos hold, or have lost their power."""
        self.gone = getattr(error, "strerror", None) or str(error) or type(error).__name__
        self._bus.close()
        while not self._stopping:
            time.sleep(REOPEN_PERIOD_S)
            try:
                self._bus = self._open()
            except (OSError, RobotFaultError):
                continue
            with self._lock:
                self._goals = self._sent = None
                self._readings.distrust()
            self.on = False
            self._counters.reopened += 1
            self.gone = None
            return

    def _end(self) -> None:
        """Let the servos hold without being told to, or go limp where that was asked for last."""
        if self.gone is not None:
            return
        try:
            if self._release:
                self._bus.set_torque(False)
            self._bus.end_watchdog()
        except OSError as error:
            self.gone = error.strerror or str(error)
        self._bus.close()
