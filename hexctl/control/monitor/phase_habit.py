"""Habit: the usual value of a quantity in each part of the gait cycle, learned during the walk."""

import numpy as np
from numpy.typing import NDArray

from hexctl.types import FloatArray

#: Parts of a cycle of a habit.
PARTS = 12

#: Slightly less, to keep a normalised time that rounds to 1 in the last part; arrays are the fastest.
JUST_PARTS: FloatArray = np.array(np.nextafter(PARTS, 0))

#: Learning rate: the time constant is this share of the time spent in its part of the cycle.
RATE_PER_CYCLE = 0.5 * PARTS


def cycle_parts(phases: FloatArray) -> NDArray[np.int64]:
    """Part of its cycle that each leg is in, 0 to `PARTS` - 1, from normalised times of 0 to 1."""
    return (phases * JUST_PARTS).astype(np.int64)


class PhaseHabit:
    """Mean of quantities of a shape in each twelfth of the cycle; `legs` are their indices in the parts."""

    def __init__(self, shape: tuple[int, ...], legs: NDArray[np.int64] | None = None) -> None:
        size = int(np.prod(shape))
        self._table: FloatArray = np.zeros(size * PARTS)
        self._first: NDArray[np.int64] = np.arange(size).reshape(shape) * PARTS
        self._legs, self._parts = legs, self._first
        self._place = self._first
        self._usual: FloatArray = np.zeros(shape)  # in the parts of the last `at`, newer than the table

    @property
    def values(self) -> FloatArray:
        """Usual values in all parts of the cycle, shape + (12,)."""
        self._table[self._place] = self._usual
        return self._table.reshape(*self._usual.shape, PARTS)

    def at(self, parts: NDArray[np.int64]) -> FloatArray:
        """Usual values in parts of the cycle, 0 to `PARTS` - 1; the same array means the same parts."""
        if parts is not self._parts:
            self._table[self._place] = self._usual
            self._parts = parts
            self._place = self._first + (parts if self._legs is None else parts.take(self._legs))
            self._usual = self._table[self._place]
        return self._usual

    def learn(self, change: FloatArray) -> None:
        """Change the usual values in the parts of the last `at`, by values of shape."""
        self._usual = self._usual + change
