"""Eighteen servo channels: what an override makes of them."""

import numpy as np

from hexctl.backends.mavlink.messages import (
    FIRST_HIGH,
    IGNORE_US,
    LEAST_US,
    MOST_US,
    RELEASE_HIGH_US,
    RELEASE_LOW_US,
)
from hexctl.errors import CommandRefusedError
from hexctl.robot.servo_map import ServoMap
from hexctl.types import N_JOINTS, BoolArray, FloatArray


class Channels:
    """What each channel was told last, by channel, (18,).

    Attributes:
        pulses_us: the pulse of each channel, within its limits; the last one where it is let go.
        active: which channels are driven.
        clipped: overrides so far of which a pulse limit changed something.
    """

    def __init__(self, servo_map: ServoMap) -> None:
        self._least_us = servo_map.by_channel(servo_map.min_us)
        self._most_us = servo_map.by_channel(servo_map.max_us)
        self.pulses_us: FloatArray = np.full(N_JOINTS, servo_map.centre_us)
        self.active: BoolArray = np.zeros(N_JOINTS, dtype=bool)
        self.clipped = 0

    def take(self, raw: list[int]) -> None:
        """Take an override over, all channels or none.

        Raises CommandRefusedError for a pulse that no servo has.
        """
        values = np.array(raw)
        high = np.arange(N_JOINTS) >= FIRST_HIGH
        # Channels 9..18 are an extension whose missing values arrive as 0: nobody meant those.
        ignored = (values == IGNORE_US) | (high & (values == 0))
        let_go = np.where(high, values == RELEASE_HIGH_US, values == RELEASE_LOW_US)
        driven = ~ignored & ~let_go
        if not ((values[driven] >= LEAST_US) & (values[driven] <= MOST_US)).all():
            raise CommandRefusedError(
                f"override: got {raw}; allowed: pulses of {LEAST_US:g} to {MOST_US:g} microseconds"
            )
        limited = np.clip(values, self._least_us, self._most_us)
        self.clipped += bool((limited != values)[driven].any())
        self.pulses_us = np.where(driven, limited, self.pulses_us)
        self.active = (self.active & ~let_go) | driven

    def let_go(self) -> None:
        """Drive no channel any more."""
        self.active = np.zeros(N_JOINTS, dtype=bool)
