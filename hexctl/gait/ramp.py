"""Soft start and stop: amplitude and height grow and shrink at a fixed rate."""

import numpy as np
from numpy.typing import ArrayLike

from hexctl.types import FloatArray

#: Share of the full amplitude gained or lost per second (the paper's demo model).
RAMP_RATE_PER_S = 0.5

#: Time from standing to the full amplitude, or back.
RAMP_DURATION_S = 1 / RAMP_RATE_PER_S


def ramp(time_s: ArrayLike, stop_s: float | None = None) -> FloatArray:
    """Return the envelope in [0, 1] at times since the start of a walk.

    Args:
        time_s: any shape; before the start (negative) the envelope is 0.
        stop_s: when the stop began, or None while walking on.
    """
    rising = np.asarray(time_s) * RAMP_RATE_PER_S
    if stop_s is None:
        return np.clip(rising, 0.0, 1.0)
    falling = min(1.0, stop_s * RAMP_RATE_PER_S) - (np.asarray(time_s) - stop_s) * RAMP_RATE_PER_S
    return np.clip(np.minimum(rising, falling), 0.0, 1.0)
