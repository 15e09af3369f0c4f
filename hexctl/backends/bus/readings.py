"""Readings of the servos on a bus: the newest of each joint, as far as it can be believed."""

import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hexctl.backends.bus.servo_bus import Report
from hexctl.types import N_JOINTS, BoolArray, FloatArray, ServoReadings

#: A reading that differs by more than a joint can is believed when this many in a row agree.
AGREEING = 3

#: How many times its greatest speed a joint may seem to have, and how far it may seem to jump besides.
SPEED_TIMES, JUMP_DEG = 2.0, 10.0

#: Readings of other quantities that agree: within so many V and degrees Celsius.
VOLTAGE_V, TEMPERATURE_C = 1.5, 5.0


class BelievedReadings:
    """Newest plausible readings of each joint; arrays are (18,).

    Single bytes that are wrong pass a checksum now and then: a position, voltage or temperature that cannot
    have come about so fast counts once three in a row agree.

    Args:
        speeds: greatest of the joints, in counts per second.
        counts_per_deg: of the servos.

    Attributes:
        positions: in counts; NaN before the first.
        implausible: readings so far that were not believed.
    """

    def __init__(self, speeds: FloatArray, counts_per_deg: FloatArray) -> None:
        self._speeds, self._jump = SPEED_TIMES * speeds, JUMP_DEG * counts_per_deg
        self.positions: FloatArray = np.full(N_JOINTS, np.nan)
        self._at_s: FloatArray = np.full(N_JOINTS, -np.inf)
        self._efforts, self._currents = np.full(N_JOINTS, np.nan), np.full(N_JOINTS, np.nan)
        self._voltages, self._temperatures = np.full(N_JOINTS, np.nan), np.full(N_JOINTS, np.nan)
        self._errors = [""] * N_JOINTS
        self._doubts: dict[tuple[str, int], tuple[float, int]] = {}
        self._trusted: BoolArray = np.ones(N_JOINTS, dtype=bool)
        self.implausible = 0

    @property
    def newest_at_s(self) -> float:
        """Time of the newest reading, on time.monotonic."""
        return float(self._at_s.max())

    @property
    def heard_at_s(self) -> "NDArray[np.float64]":
        """Times of the newest reading of each joint."""
        return self._at_s

    def take(self, reports: Sequence[Report]) -> None:
        """Take reports of some servos."""
        for report in reports:
            joint = report.joint
            reach = self._jump[joint] + self._speeds[joint] * (report.at_s - self._at_s[joint])
            reach, self._trusted[joint] = reach if self._trusted[joint] else np.inf, True
            self._believe("position", self.positions, joint, report.position, reach)
            self._believe("voltage", self._voltages, joint, report.voltage_v, VOLTAGE_V)
            self._believe("temperature", self._temperatures, joint, report.temperature_c, TEMPERATURE_C)
            self._at_s[joint] = report.at_s
            self._efforts[joint], self._currents[joint] = report.effort, report.current_a
            self._errors[joint] = report.error

    def distrust(self) -> None:
        """Believe the next reading of each joint, whatever it is: joints were moved by hand meanwhile."""
        self._trusted[:] = False
        self._doubts.clear()

    def servos(self, now_s: float | None = None) -> ServoReadings:
        """Readings with their ages at a time on time.monotonic."""
        return ServoReadings(
            ages_s=(time.monotonic() if now_s is None else now_s) - self._at_s,
            efforts=self._efforts.copy(),
            currents_a=self._currents.copy(),
            voltages_v=self._voltages.copy(),
            temperatures_c=self._temperatures.copy(),
            errors=tuple(self._errors),
        )

    def _believe(self, name: str, values: FloatArray, joint: int, value: float, reach: float) -> None:
        """Take a value that is within reach of the one before, or with which as many as it takes agree."""
        if np.isnan(value):  # not read this time
            return
        before, key = values[joint], (name, joint)
        if np.isnan(before) or abs(value - before) <= reach:
            values[joint] = value
            self._doubts.pop(key, None)
            return
        doubted, times = self._doubts.get(key, (value, 0))
        times = times + 1 if abs(value - doubted) <= reach else 1
        if times >= AGREEING:
            values[joint] = value
            self._doubts.pop(key, None)
        else:
            self.implausible += 1
            self._doubts[key] = (value, times)
