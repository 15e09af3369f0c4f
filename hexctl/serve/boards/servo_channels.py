"""Servo channels of a board as overrides command them."""

import numpy as np

from hexctl.backends.mavlink.mavlink_messages import (
    FIRST_HIGH,
    IGNORE_US,
    LEAST_US,
    MOST_US,
    RELEASE_HIGH_US,
    RELEASE_LOW_US,
)
from hexctl.errors import CommandRefusedError
from hexctl.robot.servos.servo_map import ServoMap
from hexctl.types import N_JOINTS, BoolArray, FloatArray


class Channels:
    """Last override of each servo channel; arrays are (18,), by channel.

    Attributes:
        pulses_us: pulse of each channel, within its limits; the last one where it is released.
        active: which channels are driven.
        clipped: overrides so far that a pulse limit changed.
    """

    def __init__(self, servo_map: ServoMap) -> None:
        self._least_us = servo_map.by_channel(servo_map.least)
        self._most_us = servo_map.by_channel(servo_map.most)
        self.pulses_us: FloatArray = servo_map.by_channel(servo_map.centre)
        self.active: BoolArray = np.zeros(N_JOINTS, dtype=bool)
        self.clipped = 0

    def take(self, raw: list[int]) -> None:
        """Apply an override, all channels or none.

        Raises CommandRefusedError for a pulse outside the range of servos.
        """
        values = np.array(raw)
        released, driven = _released_and_driven(raw)
        if not ((values[driven] >= LEAST_US) & (values[driven] <= MOST_US)).all():
            raise CommandRefusedError(
                f"override: got {raw}; allowed: pulses of {LEAST_US:g} to {MOST_US:g} microseconds"
            )
        limited = np.clip(values, self._least_us, self._most_us)
        self.clipped += bool((limited != values)[driven].any())
        self.pulses_us = np.where(driven, limited, self.pulses_us)
        self.active = (self.active & ~released) | driven

    def release(self) -> None:
        """Release all channels."""
        self.active = np.zeros(N_JOINTS, dtype=bool)

    def released_by(self, raw: list[int]) -> bool:
        """Whether an override leaves no channel driven."""
        released, driven = _released_and_driven(raw)
        return not (driven | (self.active & ~released)).any()


def _released_and_driven(raw: list[int]) -> tuple[BoolArray, BoolArray]:
    """Which channels an override (18,) releases, and which it drives; it leaves the others as they are."""
    values, high = np.array(raw), np.arange(N_JOINTS) >= FIRST_HIGH
    # Channels 9..18 are an extension whose missing values arrive as 0: ignored.
    ignored = (values == IGNORE_US) | (high & (values == 0))
    released = np.where(high, values == RELEASE_HIGH_US, values == RELEASE_LOW_US)
    return released, ~ignored & ~released
