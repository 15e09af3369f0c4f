"""Plausible readings of the servos on a bus."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hexctl.backends.bus.servo_bus import Report, ServoBus
from hexctl.types import N_JOINTS, BoolArray, FloatArray, ServoReadings

#: Readings in a row that must agree to be accepted after an implausible jump, and as the first ones.
AGREEING, AGREEING_AT_FIRST = 3, 2

#: Polls of all servos after which positions that do not agree are left.
MOST_POLLS = 6

#: Plausible multiple of a joint's maximum speed, and an additional plausible jump.
SPEED_TIMES, JUMP_DEG = 2.0, 4.0

#: How far readings of other quantities that agree may differ, in V and degrees Celsius.
VOLTAGE_V, TEMPERATURE_C = 1.5, 5.0


@dataclass(slots=True)
class _Quantity:
    """Newest accepted value of one quantity, and one in doubt with the number of agreeing values, `times`.

    `follows` is whether the next value must follow on the accepted one.
    """

    value: float = math.nan
    follows: bool = False
    doubted: float = math.nan
    times: int = 0

    def take(self, value: float, reach: float) -> bool:
        """Whether the value was taken: it is within reach of the accepted one, or enough readings agree."""
        self.times = self.times + 1 if abs(value - self.doubted) <= reach else 1
        near = self.follows and abs(value - self.value) <= reach
        if near or self.times >= (AGREEING if self.follows else AGREEING_AT_FIRST):
            self.value, self.follows = value, True
            self.forget_doubt()
            return True
        self.doubted = value
        return False

    def forget_doubt(self) -> None:
        self.doubted, self.times = math.nan, 0


class BelievedReadings:
    """Newest plausible readings of each joint; arrays are (18,), maximum speeds in counts per second.

    Wrong bytes sometimes pass a checksum. An implausible jump of a position, voltage or temperature counts
    once three readings in a row agree, a first reading once two agree. `implausible` counts the others.
    """

    def __init__(self, speeds: FloatArray, counts_per_deg: FloatArray) -> None:
        # Lists: a report changes single numbers, which take several times as long in an array.
        self._speeds, self._jumps = (SPEED_TIMES * speeds).tolist(), (JUMP_DEG * counts_per_deg).tolist()
        self._positions, self._voltages, self._temperatures = (
            [_Quantity() for _ in range(N_JOINTS)] for _ in range(3)
        )
        self._efforts, self._currents = [math.nan] * N_JOINTS, [math.nan] * N_JOINTS
        self._heard_at_s = [-math.inf] * N_JOINTS
        self._measured_at_s = [-math.inf] * N_JOINTS  # when a position was accepted
        self._errors = [""] * N_JOINTS
        self.implausible = 0

    @property
    def positions(self) -> FloatArray:
        """Positions in counts; NaN before the first."""
        return _values(self._positions)

    @property
    def trusted(self) -> BoolArray:
        """Whether the position of each joint is confirmed by earlier ones."""
        return np.array([each.follows for each in self._positions])

    @property
    def heard_at_s(self) -> FloatArray:
        """Times of the newest reading of each joint, accepted or not."""
        return np.array(self._heard_at_s)

    def take(self, reports: Sequence[Report]) -> None:
        """Take reports of some servos."""
        for report in reports:
            joint = report.index
            # Since the last reading, not the last accepted one: in time, any value would become plausible.
            reach = self._jumps[joint] + self._speeds[joint] * (report.at_s - self._heard_at_s[joint])
            if self._accept(self._positions[joint], report.position, reach):
                self._measured_at_s[joint] = report.at_s
            self._accept(self._voltages[joint], report.voltage_v, VOLTAGE_V)
            self._accept(self._temperatures[joint], report.temperature_c, TEMPERATURE_C)
            self._heard_at_s[joint] = report.at_s
            self._efforts[joint], self._currents[joint] = report.effort, report.current_a
            self._errors[joint] = report.error

    def distrust(self) -> None:
        """Forget the positions: joints may have been moved by hand."""
        for position in self._positions:
            position.follows = False
        for each in (*self._positions, *self._voltages, *self._temperatures):
            each.forget_doubt()

    def servos(self, now_s: float) -> ServoReadings:
        """Readings with the ages of the accepted positions."""
        return ServoReadings(
            ages_s=now_s - np.array(self._measured_at_s),
            efforts=np.array(self._efforts),
            currents_a=np.array(self._currents),
            voltages_v=_values(self._voltages),
            temperatures_c=_values(self._temperatures),
            errors=tuple(self._errors),
        )

    def _accept(self, quantity: _Quantity, value: float, reach: float) -> bool:
        if math.isnan(value):
            return False
        follows, taken = quantity.follows, quantity.take(value, reach)
        self.implausible += follows and not taken
        return taken


def _values(quantities: Sequence[_Quantity]) -> FloatArray:
    return np.array([each.value for each in quantities])


def polls(bus: ServoBus, readings: BelievedReadings) -> Iterator[list[Report]]:
    """Reports of all servos, repeatedly, until the positions of those that answer are trusted."""
    answering: set[int] = set()
    for _ in range(MOST_POLLS):
        reports = bus.poll_all()
        yield reports
        answering |= {report.index for report in reports}
        if readings.trusted[sorted(answering)].all():
            return
