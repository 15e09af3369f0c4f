"""Delay of messages on their way, by two clocks that need not agree."""

import math

#: Bound on the relative drift of two monotonic clocks: 100 ppm each, up to 500 ppm while NTP slews one.
DRIFT = 1000e-6


class TransitDelay:
    """Delay of each message relative to the fastest one so far.

    A delay above `other_clock_s` means that the sender has started again, with another clock.
    """

    def __init__(self, other_clock_s: float = math.inf) -> None:
        self._other_clock_s = other_clock_s
        self._fastest_s = math.inf
        self._at_s = -math.inf

    def delay_s(self, stamp_s: float, arrived_s: float) -> float:
        """Time by which a message took longer than the fastest one so far, in s."""
        took_s = arrived_s - stamp_s
        if math.isfinite(self._at_s):
            self._fastest_s += DRIFT * max(0.0, arrived_s - self._at_s)
        self._at_s = max(self._at_s, arrived_s)
        if took_s - self._fastest_s > self._other_clock_s:
            self._fastest_s = took_s
        self._fastest_s = min(self._fastest_s, took_s)
        return took_s - self._fastest_s
