"""Measurements of a walk that drop out, jump or freeze."""

import math

import numpy as np

from hexctl.types import BoolArray, FloatArray, any_of, chosen

#: A position or yaw missing for longer is lost: its part of the law then decays.
LOST_AFTER_S = 1.0

#: A value constant for longer counts as lost.
FROZEN_AFTER_S = 4.0

#: With room for rounding: sums and products of control periods are judged alike.
LONGEST_SAME_S = FROZEN_AFTER_S + 1e-6

#: A change that no walking robot makes. The bound grows by half of itself in a second, to accept a lasting
#: one.
JUMP_M = 0.25
JUMP_RAD = math.radians(30.0)
JUMP_GROWTH_PER_S = 0.5

#: As a scalar of NumPy, which those of a single robot stay.
ZERO: FloatArray = np.float64(0.0)  # type: ignore[assignment]


class Measured:
    """A measured number, leading shape; dropouts and jumps keep the last value, and are not fresh."""

    def __init__(self, first: FloatArray, jump: float) -> None:
        self.value: FloatArray = first
        self.fresh: BoolArray = np.ones(np.shape(first), dtype=bool)[()]
        self.missing_s: FloatArray = np.zeros(np.shape(first))[()]
        self._jump = jump

    def update(self, raw: FloatArray, dt_s: float) -> None:
        """Take a measurement, NaN if there is none."""
        most = self._jump * (1 + JUMP_GROWTH_PER_S * self.missing_s)
        self.fresh = abs(raw - self.value) <= most
        self.value = chosen(self.fresh, raw, self.value)
        self.missing_s = chosen(self.fresh, ZERO, self.missing_s + dt_s)

    @property
    def lost(self) -> BoolArray:
        """Whether it is missing for longer than a dropout."""
        return self.missing_s > LOST_AFTER_S


class FrozenSensor:
    """Detects a sensor that repeats its value for `FROZEN_AFTER_S`, dropouts excluded."""

    def __init__(self) -> None:
        self.last: tuple[FloatArray, ...] = ()
        self._same_s = ZERO

    def update(self, dt_s: float, *values: FloatArray) -> BoolArray:
        """Take the values of a tick, leading shape each: whether they are frozen, or NaN (not measured)."""
        seen = values[0] == values[0]  # NaN is not; faster than isnan or `~`
        unseen: BoolArray = values[0] != values[0]
        same = seen if self.last else seen & False
        for value, before in zip(values, self.last, strict=False):
            same = same & (value == before)
        self._same_s = chosen(seen, chosen(same, self._same_s + dt_s, ZERO), self._same_s)
        if any_of(unseen) and self.last:
            values = tuple(chosen(seen, *pair) for pair in zip(values, self.last, strict=True))
        self.last = values
        return (self._same_s > LONGEST_SAME_S) | unseen


def frozen_rows(values: FloatArray, period_s: float) -> BoolArray:
    """Ticks with a frozen value, (T,), of values (T, n) of a complete walk; all repetitions count."""
    frozen = np.zeros(len(values), dtype=bool)
    seen = np.flatnonzero(np.isfinite(values[:, 0]))
    if len(seen) < 2:
        return frozen
    repeats = np.concatenate([[False], (values[seen[1:]] == values[seen[:-1]]).all(axis=-1)])
    run = np.cumsum(~repeats) - 1
    same_s = np.bincount(run, weights=repeats) * period_s
    frozen[seen[repeats & (same_s[run] > LONGEST_SAME_S)]] = True
    return frozen
