"""The thread that owns a bus: sends the newest goals at once, and asks for reports in between."""

import threading
import time
from collections.abc import Callable

import numpy as np

from hexctl.backends.bus.readings import BelievedReadings
from hexctl.backends.bus.servo_bus import BusCounters, ServoBus
from hexctl.errors import RobotFaultError
from hexctl.types import BoolArray, FloatArray, ServoReadings

#: Reports are asked for once in this time, after the goals of the tick if there are any.
POLL_PERIOD_S = 0.02

#: How often it is tried to open a port that has gone.
REOPEN_PERIOD_S = 0.25


class BusThread:
    """Runs a bus between `start` and `stop`.

    Its methods leave or take something, and never wait for the bus.

    Args:
        opened: makes the bus anew, when the port has gone and may be back.
        bus: found and prepared.
        readings: that are kept.
        counters: of the bus.

    Attributes:
        gone: why the port cannot be used at this moment, or None.
        on: whether the servos hold.
    """

    def __init__(
        self,
        opened: Callable[[], ServoBus],
        bus: ServoBus,
        readings: BelievedReadings,
        counters: BusCounters,
    ) -> None:
        self._open, self._bus, self._readings, self._counters = opened, bus, readings, counters
        self._lock, self._wake = threading.Lock(), threading.Event()
        self._goals: FloatArray | None = None
        self._torque: bool | None = None  # that is wanted and not yet switched
        self.on = False
        self._stopping = False
        self.gone: str | None = None
        self._thread = threading.Thread(target=self._run, name="servo bus", daemon=True)

    def start(self, *, on: bool) -> None:
        """Begin; `on` says whether the servos hold already."""
        self.on = on
        self._thread.start()

    def stop(self) -> None:
        """End after the packet that is on the line; the servos hold."""
        self._stopping = True
        self._wake.set()
        self._thread.join()

    def send(self, counts: FloatArray) -> None:
        """Leave goals, (18,) in counts, in place of any that have not been sent."""
        with self._lock:
            self._goals = counts
            if self._torque is False:
                self._torque = None
        self._wake.set()

    def release(self) -> None:
        """Let the torque be switched off; goals that have not been sent are dropped."""
        with self._lock:
            self._goals, self._torque = None, False
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
                wrote = self._tell()
                if wrote or time.monotonic() >= due_s:
                    due_s = time.monotonic() + POLL_PERIOD_S
                    self._hear(self._bus.poll())
            except OSError as error:
                self._reopen(error)
                due_s = time.monotonic()
        if self.gone is None:
            self._end()

    def _tell(self) -> bool:
        """Send what was left; whether that was anything."""
        with self._lock:
            goals, self._goals = self._goals, None
            torque, self._torque = self._torque, None
        if torque is False:
            self._bus.set_torque(False)
            self.on = False
        if goals is None:
            return torque is not None
        if not self.on:
            self._hold_where_it_is()
        self._bus.write_goals(goals)
        return True

    def _hold_where_it_is(self) -> None:
        """Switch the torque on with each goal where its joint is now, so that nothing jumps."""
        with self._lock:
            self._readings.forget()
        self._hear(self._bus.poll_all())
        with self._lock:
            here = self._readings.positions.copy()
        known: BoolArray = np.isfinite(here)
        self._bus.hold(np.where(known, here, 0.0), known)
        self.on = True

    def _hear(self, reports: list) -> None:  # type: ignore[type-arg]
        with self._lock:
            self._readings.take(reports)
            self._counters.implausible = self._readings.implausible

    def _reopen(self, error: OSError) -> None:
        """Wait until the port is back, and begin as at first: the servos hold, or have lost their power."""
        self.gone = error.strerror or str(error)
        self._bus.close()
        while not self._stopping:
            time.sleep(REOPEN_PERIOD_S)
            try:
                self._bus = self._open()
            except (OSError, RobotFaultError):
                continue
            with self._lock:
                self._goals = self._torque = None
                self._readings.forget()
            self.on = False
            self._counters.reopened += 1
            self.gone = None
            return

    def _end(self) -> None:
        """Let the servos hold without being told to."""
        try:
            self._bus.end_watchdog()
        except OSError as error:
            self.gone = error.strerror or str(error)
        self._bus.close()
