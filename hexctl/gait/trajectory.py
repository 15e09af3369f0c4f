"""The foot trajectory of the paper (Eq. 3 to 5), normalised to amplitude 1 and height 1.

Stance is the two thirds of the cycle in which the offset grows, swing the third (u in [1/3, 2/3)) in which
the foot returns through the air.
"""

import numpy as np
from numpy.typing import ArrayLike

from hexctl.types import BoolArray, FloatArray

SWING_START, SWING_TOP, SWING_END = 1 / 3, 1 / 2, 2 / 3


def phase_in_cycle(cycles: ArrayLike, slots: ArrayLike) -> FloatArray:
    """Return the normalised time u in [0, 1) of each leg (Eq. 5): u = mod(t + (g - 1) / 6, 1).

    Args:
        cycles: t, gait cycles since the start; broadcasts against the slots.
        slots: g, the phase slot of each leg, 1..6.
    """
    u = np.mod(np.asarray(cycles) + (np.asarray(slots) - 1) / 6, 1.0)
    # mod of a tiny negative rounds to 1.0 itself, which is the start of the cycle.
    return np.where(u == 1.0, 0.0, u)


def stroke_offset(u: FloatArray) -> FloatArray:
    """Return the offset in the plane as a fraction of the amplitude (Eq. 3), in [-1/2, 1/2]."""
    return np.where(
        u < SWING_START,
        1.5 * u,
        np.where(u < SWING_END, 1.5 - 3.0 * u, -0.5 + 1.5 * (u - SWING_END)),
    )


def lift_offset(u: FloatArray) -> FloatArray:
    """Return the height offset as a fraction of the step height (Eq. 4), in [0, 1]."""
    return np.clip(1.0 - 6.0 * np.abs(u - SWING_TOP), 0.0, None)


def in_stance(u: FloatArray) -> BoolArray:
    """Return where the foot is meant to be on the floor."""
    return (u < SWING_START) | (u >= SWING_END)
