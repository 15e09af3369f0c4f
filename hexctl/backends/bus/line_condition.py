"""Diagnosis of bad communication or lost torque on a bus: low voltage, or a bad cable.

In a brown-out many servos report low voltage and restart without torque, some without their id. A bad cable
or noise damages answers while the voltage is good, often those of one leg.
"""

import numpy as np

from hexctl.backends.bus.bus_map import BusMap
from hexctl.backends.bus.servo_bus import WINDOW, AnswerShares
from hexctl.time_source import WALL_TIME, TimeSource
from hexctl.types import N_JOINTS, BoolArray, FloatArray, ServoReadings

#: Bad answers with which a share is no accident.
LEAST_BAD = 10

#: Share of damaged or missing answers that starts a warning, and share that ends it.
DAMAGED, GOOD = 0.05, 0.03

#: Number of restarted servos from which the supply is blamed.
SEVERAL = 3

#: With as many damaged lines it is the bus, not the cable of a leg.
MOST_LINES = 6

#: Share of their voltage at connect, below which servos have a brown-out.
SAGGED = 0.8

#: Error of restarted servos. Other servos without torque report their own reason.
_OF_A_RESTART = ("", "limp", "voltage", "hardware alert", "hardware alert (voltage)")

#: How long a brown-out explains what servos do, and how fast the usual voltage follows a battery's.
REMEMBERS_S, DRAINS_S = 10.0, 60.0


class LineCondition:
    """Warnings about the line and the supply of a bus."""

    def __init__(self, servos: BusMap, shares: AnswerShares, *, time: TimeSource = WALL_TIME) -> None:
        self._map, self._shares, self._time = servos, shares, time
        self._usual_v = np.nan  # until most servos have reported a voltage
        self._at_s = self._sagged_at_s = -np.inf
        self._low_v = np.inf  # lowest of a brown-out
        self._bad: BoolArray = np.zeros(N_JOINTS, dtype=bool)  # joints with damaged answers

    def warnings(self, servos: ServoReadings, limp: BoolArray, mute: BoolArray) -> list[str]:
        """Warnings, unchanged while nothing changes; `limp` and `mute` are joints, (18,)."""
        now_s = self._time.now()
        low = self._low(servos.voltages_v, now_s)
        if np.count_nonzero(low) >= SEVERAL:
            self._low_v = min(self._low_v, float(np.median(servos.voltages_v[low])))
            self._sagged_at_s = now_s
        elif now_s - self._sagged_at_s > REMEMBERS_S:
            self._low_v = np.inf
        sags = bool(np.isfinite(self._low_v))
        unloaded = np.array(["limp" in error for error in servos.errors])
        restarted = (limp | unloaded) & np.array([error in _OF_A_RESTART for error in servos.errors])
        if sags or np.count_nonzero(restarted) >= SEVERAL:
            return [self._brown_out(restarted, mute & sags)]
        return self._damaged(mute)

    def _low(self, voltages_v: FloatArray, now_s: float) -> BoolArray:
        known = np.isfinite(voltages_v)
        if not known.any():
            return known
        low: BoolArray = known & (voltages_v < SAGGED * self._usual_v)
        if np.count_nonzero(known) > N_JOINTS // 2 and np.count_nonzero(low) < SEVERAL:
            median_v = float(np.median(voltages_v[known]))
            passed = min(1.0, (now_s - self._at_s) / DRAINS_S)
            before = median_v if np.isnan(self._usual_v) else self._usual_v
            self._usual_v, self._at_s = before + passed * (median_v - before), now_s
        return low

    def _brown_out(self, restarted: BoolArray, lost: BoolArray) -> str:
        words = []
        if np.isfinite(self._low_v):
            now = f"{np.floor(2 * self._low_v) / 2:g} V"
            words.append(f"the voltage of several servos fell from {self._usual_v:.0f} V to {now}")
        if np.count_nonzero(restarted) >= SEVERAL:
            words.append("several have restarted without torque")
        if lost.any():
            words.append(f"some have lost their ids ({self._map.names(lost)})")
        return f"brown-out: {'; '.join(words)}; is the supply strong enough, and the battery full?"

    def _damaged(self, mute: BoolArray) -> list[str]:
        shares = np.where(mute, 0.0, self._shares.damaged)
        bad_answers = shares * np.minimum(self._shares.asked, WINDOW)
        begins = (shares >= DAMAGED) & (bad_answers >= LEAST_BAD)
        self._bad = begins | (self._bad & (shares >= GOOD))
        if not self._bad.any():
            return []
        count = np.count_nonzero(self._bad)
        whose = f"{count} servos" if count > MOST_LINES else self._map.names(self._bad)
        return [f"bad cable or noise: answers of {whose} are damaged or missing"]
