"""The thread that owns a bus of servos."""

import time
from collections.abc import Callable, Sequence

import numpy as np

from hexctl.backends.bus.readings import BelievedReadings, polls
from hexctl.backends.bus.servo_bus import BusCounters, Report, ServoBus
from hexctl.backends.port_thread import PortThread
from hexctl.types import BoolArray, FloatArray, ServoReadings

#: After a gap this long between its packets the servos' own watchdog may have expired.
GAP_S = 0.15


class BusThread(PortThread[ServoBus]):
    """Runs a bus: servos that report where they are, and hold there before they follow.

    Args:
        opened: makes the bus again, when the port has gone and may be back.
        bus: found and prepared.
        readings: that are kept.
        counters: of the bus.
        speeds: greatest of the joints, (18,), in counts per second.

    Attributes:
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
        super().__init__(opened, bus, counters=counters, speeds=speeds, name="servo bus")
        self._readings, self._counters = readings, counters
        self._asked = 0  # joint whose torque was read last
        self._active_at_s = -np.inf
        self.limp: BoolArray = np.zeros(len(speeds), dtype=bool)
        self._held: BoolArray = np.zeros(len(speeds), dtype=bool)

    def start(self, *, on: bool = False) -> None:
        """Begin; servos that hold already, `on`, approach the first targets from where they are."""
        self._sent = self._readings.positions.copy() if on else None
        self._held = np.isfinite(self._readings.positions)
        super().start(on=on)

    def newest(self) -> tuple[FloatArray, ServoReadings, FloatArray]:
        """Newest positions in counts, what the servos report, and how long each was silent in s, (18,)."""
        with self._lock:
            now_s = time.monotonic()
            readings = self._readings
            return readings.positions.copy(), readings.servos(now_s), now_s - readings.heard_at_s

    def _follow(self, targets: FloatArray) -> FloatArray:
        if not self.on:
            self._hold_where_it_is()
        elif time.monotonic() - self._active_at_s > GAP_S:
            self._device.renew_watchdog()
        near = self._stepped(targets)
        # Some servos switch their torque on with a goal: one that has let go would jump to it.
        self._device.write_goals(np.where(self._held, near, np.nan))
        return near

    def _let_go(self) -> None:
        self._device.set_torque(False)
        self.limp[:] = False

    def _poll(self) -> None:
        reports = self._device.poll(lambda: self._targets is not None)
        self._take(reports)
        if reports:  # where none came, another question would only be waited for too
            self._check_torque()
        self._active_at_s = time.monotonic()

    def _meet(self) -> None:
        with self._lock:
            self._readings.distrust()

    def _finish(self) -> None:
        self._device.end_watchdog()

    def _hold_where_it_is(self) -> None:
        """Switch the torque on with each goal where its joint is now, so that nothing jumps."""
        with self._lock:
            self._readings.distrust()
        begun_s = time.monotonic()
        for reports in polls(self._device, self._readings):
            self._take(reports)
        with self._lock:
            here = self._readings.positions.copy()
        heard: BoolArray = self._readings.heard_at_s >= begun_s
        known: BoolArray = self._readings.trusted & heard
        self._held = self._device.hold(np.where(known, here, 0.0), known)
        self.limp = heard & ~self._held
        self._sent = np.where(known, here, np.nan)

    def _check_torque(self) -> None:
        """Ask one joint after the other whether it still holds: servos trip, and restart without torque."""
        if not self.on or self._device.reports_limp:
            return
        self._asked = (self._asked + 1) % len(self.limp)
        torque = self._device.torque(self._asked, tries=1)
        if torque is False:  # a wrong answer is rare, two of them never come
            torque = self._device.torque(self._asked, tries=1)
        if torque is False:
            self.limp[self._asked], self._held[self._asked] = True, False

    def _take(self, reports: Sequence[Report]) -> None:
        with self._lock:
            self._readings.take(reports)
            self._counters.implausible = self._readings.implausible
