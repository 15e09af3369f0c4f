"""A controller that drives the sketch in `firmware/`, in steps of a millisecond."""

from typing import Any

import numpy as np

from hexctl.backends.mavlink import mavlink_messages
from hexctl.backends.mavlink.codec import Codec
from hexctl.types import FloatArray
from tests.firmware.boards import Firmware, decoded

STANCE = np.full(18, 1500.0)
TICK_S = 0.02

#: Longest and shortest pulses are those of `config.h`; one count of a chip lasts 4.88 us.
LEAST_US, MOST_US, COUNT_US = 500.0, 2500.0, 122 / 25


class Driver:
    """A controller, and the board that it drives in steps of a millisecond; `now_s` is the time of both."""

    def __init__(self, *, begins_s: float = 0.0, **options: Any) -> None:
        self.firmware = Firmware(STANCE, **options)
        self.codec, self.now_s, self.sequence = Codec(255, 191), begins_s, 0
        self.firmware.begin(self.now_s)
        self.frames: list[bytes] = []
        self.pass_time(0.1)

    def encode(self, message: Any) -> bytes:
        """The next frame of a message."""
        self.sequence += 1
        return self.codec.encode(message, self.sequence - 1)

    def override(self, pulses: FloatArray, times: int = 1) -> None:
        """Command pulses at 50 Hz."""
        for _ in range(times):
            self.say(self.encode(mavlink_messages.override(pulses, 1, 1)))
            self.pass_time(TICK_S)

    def say(self, data: bytes) -> None:
        """Let bytes come now."""
        self.frames += self.firmware.run(self.now_s, data)

    def pass_time(self, duration_s: float) -> None:
        """Let the program run meanwhile."""
        until_s = self.now_s + duration_s
        while self.now_s < until_s - 1e-9:
            self.now_s = round(self.now_s + 0.001, 6)
            self.frames += self.firmware.run(self.now_s)

    def newest(self, kind: str) -> Any:
        """Newest message of a kind."""
        return self.all(kind)[-1]

    def all(self, kind: str) -> list[Any]:
        """All messages of a kind."""
        return decoded(self.frames, kind)

    def time_until(self, condition: Any, within_s: float) -> float:
        """Time until something is so."""
        begun_s = self.now_s
        while not condition():
            assert self.now_s - begun_s < within_s
            self.pass_time(0.001)
        return round(self.now_s - begun_s, 6)
