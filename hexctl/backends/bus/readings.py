"""Readings of the servos on a bus: the newest of each joint, as far as it can be believed."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from hexctl.backends.bus.servo_bus import Report, ServoBus
from hexctl.types import N_JOINTS, BoolArray, FloatArray, ServoReadings

#: A reading that differs by more than a joint can is believed when this many in a row agree, and one that
#: follows on none when two do.
AGREEING, AGREEING_AT_FIRST = 3, 2

#: Polls of all servos after which positions that do not agree are left.
MOST_POLLS = 6

#: How many times its greatest speed a joint may seem to have, and how far it may seem to jump besides.
SPEED_TIMES, JUMP_DEG = 2.0, 4.0

#: How far readings of other quantities that agree may differ, in V and degrees Celsius.
VOLTAGE_V, TEMPERATURE_C = 1.5, 5.0


class BelievedReadings:
    """Newest plausible readings of each joint; arrays are (18,).

    Single bytes that are wrong pass a checksum now and then: a position, voltage or temperature that cannot
    have come about so fast counts once three in a row agree. The first of each, a position from which a
    robot begins to move or a temperature that stops it, counts once two agree.

    Args:
        speeds: greatest of the joints, in counts per second.
        counts_per_deg: of the servos.

    Attributes:
        positions: in counts; NaN before the first.
        trusted: whether the position of each joint follows on others.
        implausible: readings so far that were not believed.
    """

    def __init__(self, speeds: FloatArray, counts_per_deg: FloatArray) -> None:
        self._speeds, self._jump = SPEED_TIMES * speeds, JUMP_DEG * counts_per_deg
        self.positions: FloatArray = np.full(N_JOINTS, np.nan)
        self._heard_at_s: FloatArray = np.full(N_JOINTS, -np.inf)
        self._measured_at_s: FloatArray = np.full(N_JOINTS, -np.inf)  # when a position was believed
        self._efforts, self._currents = np.full(N_JOINTS, np.nan), np.full(N_JOINTS, np.nan)
        self._voltages, self._temperatures = np.full(N_JOINTS, np.nan), np.full(N_JOINTS, np.nan)
        self._errors = [""] * N_JOINTS
        self._doubts: dict[tuple[str, int], tuple[float, int]] = {}
        self.trusted: BoolArray = np.zeros(N_JOINTS, dtype=bool)
        self.implausible = 0

    @property
    def heard_at_s(self) -> "NDArray[np.float64]":
        """Times of the newest reading of each joint, believed or not."""
        return self._heard_at_s

    def take(self, reports: Sequence[Report]) -> None:
        """Take reports of some servos."""
        for report in reports:
            joint = report.place
            # Since the last reading, not the last that was believed: after a while any would be in reach.
            reach = self._jump[joint] + self._speeds[joint] * (report.at_s - self._heard_at_s[joint])
            follows = bool(self.trusted[joint])
            taken = self._believe("position", self.positions, joint, report.position, reach, follows=follows)
            self.trusted[joint] = follows or taken
            if taken:
                self._measured_at_s[joint] = report.at_s
            for name, values, value, near in (
                ("voltage", self._voltages, report.voltage_v, VOLTAGE_V),
                ("temperature", self._temperatures, report.temperature_c, TEMPERATURE_C),
            ):
                self._believe(name, values, joint, value, near, follows=bool(np.isfinite(values[joint])))
            self._heard_at_s[joint] = report.at_s
            self._efforts[joint], self._currents[joint] = report.effort, report.current_a
            self._errors[joint] = report.error

    def distrust(self) -> None:
        """Accept any first position of each joint again: joints were moved by hand meanwhile."""
        self.trusted[:] = False
        self._doubts.clear()

    def servos(self, now_s: float) -> ServoReadings:
        """Readings with the ages of the positions, which are believed ones, at a time."""
        return ServoReadings(
            ages_s=now_s - self._measured_at_s,
            efforts=self._efforts.copy(),
            currents_a=self._currents.copy(),
            voltages_v=self._voltages.copy(),
            temperatures_c=self._temperatures.copy(),
            errors=tuple(self._errors),
        )

    def _believe(
        self, name: str, values: FloatArray, joint: int, value: float, reach: float, *, follows: bool = True
    ) -> bool:
        """Take a value that is within reach of the one before, or with which as many as it takes agree.

        One that follows on none has to agree with the one that was read before it. Whether it was taken.
        """
        if np.isnan(value):  # not read this time
            return False
        before, key = values[joint], (name, joint)
        doubted, times = self._doubts.pop(key, (value, 0))
        times = times + 1 if abs(value - doubted) <= reach else 1
        near = follows and abs(value - before) <= reach
        if near or times >= (AGREEING if follows else AGREEING_AT_FIRST):
            values[joint] = value
            return True
        self.implausible += follows
        self._doubts[key] = (value, times)
        return False


def polls(bus: ServoBus, readings: BelievedReadings) -> Iterator[list[Report]]:
    """Reports of all servos, again and again until the positions of those that answer are trusted."""
    answering: set[int] = set()
    for _ in range(MOST_POLLS):
        reports = bus.poll_all()
        yield reports
        answering |= {report.place for report in reports}
        if readings.trusted[sorted(answering)].all():
            return
