"""Habit: what a quantity usually is at each part of the gait cycle, learned while the robot walks."""

import numpy as np
from numpy.typing import NDArray

from hexctl.types import FloatArray

#: Parts of a cycle that a habit tells apart.
PARTS = 12

#: How fast a habit follows: the time constant is this share of the time spent in its part of the cycle.
RATE_PER_CYCLE = 0.5 * PARTS


class PhaseHabit:
    """Mean of quantities, and of how far they are from it, at each twelfth of the gait cycle.

    Args:
        shape: leading shape + (quantities,).
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self._mean: FloatArray = np.zeros((*shape, PARTS))
        self._spread: FloatArray = np.zeros((*shape, PARTS))
        self._first: NDArray[np.int64] = np.arange(int(np.prod(shape))).reshape(shape) * PARTS
        self._place = self._first

    def begin(self, values: FloatArray) -> None:
        """Take values of shape as what is usual everywhere."""
        self._mean[:] = values[..., np.newaxis]
        self._spread[:] = 0.0

    def at(self, parts: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
        """Mean and spread at parts of the cycle, 0 to `PARTS` - 1, each of shape."""
        self._place = self._first + parts
        return self._mean.take(self._place), self._spread.take(self._place)

    def learn(self, off_mean: FloatArray, off_spread: FloatArray) -> None:
        """Move mean and spread at the parts asked for last by what is given, of shape."""
        self._mean.put(self._place, self._mean.take(self._place) + off_mean)
        self._spread.put(self._place, self._spread.take(self._place) + off_spread)
