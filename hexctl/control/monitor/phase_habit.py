"""Habit: what a quantity usually is at each part of the gait cycle, learned while the robot walks."""

import numpy as np
from numpy.typing import NDArray

from hexctl.types import FloatArray

#: Parts of a cycle that a habit tells apart.
PARTS = 12

#: A little less, so that a normalised time that rounds to 1 is in the last part; an array is the fastest.
JUST_PARTS: FloatArray = np.array(np.nextafter(PARTS, 0))

#: How fast a habit follows: the time constant is this share of the time spent in its part of the cycle.
RATE_PER_CYCLE = 0.5 * PARTS


def cycle_parts(phases: FloatArray) -> NDArray[np.int64]:
    """Part of its cycle that each leg is in, 0 to `PARTS` - 1, from normalised times of 0 to 1."""
    return (phases * JUST_PARTS).astype(np.int64)


class PhaseHabit:
    """Mean of quantities at each twelfth of the gait cycle.

    Args:
        shape: of the quantities.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        size = int(np.prod(shape))
        self._table: FloatArray = np.zeros(size * PARTS)
        self._first: NDArray[np.int64] = np.arange(size).reshape(shape) * PARTS
        self._place = self._first
        self._usual: FloatArray = np.zeros(shape)

    @property
    def values(self) -> FloatArray:
        """What is usual at all parts of the cycle, shape + (12,)."""
        return self._table.reshape(*self._usual.shape, PARTS)

    def at(self, parts: NDArray[np.int64]) -> FloatArray:
        """What is usual at parts of the cycle, 0 to `PARTS` - 1, both of shape."""
        self._place = self._first + parts
        self._usual = self._table[self._place]
        return self._usual

    def learn(self, change: FloatArray) -> None:
        """Change what is usual at the parts asked for last, by values of shape."""
        self._table[self._place] = self._usual + change
