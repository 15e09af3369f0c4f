"""Delay of messages on their way, by two clocks that need not agree."""

import math
from collections import OrderedDict

#: Bound on the relative drift of two monotonic clocks: 100 ppm each, up to 500 ppm while NTP slews one.
DRIFT = 1000e-6

#: The same for the ceramic resonator of a microcontroller.
BOARD_DRIFT = 0.02


class TransitDelay:
    """Delay of each message relative to the fastest one so far.

    A delay above `other_clock_s` means that the sender has started again, with another clock.
    """

    def __init__(self, other_clock_s: float = math.inf, *, drift: float = DRIFT) -> None:
        self._other_clock_s, self._drift = other_clock_s, drift
        self._fastest_s = math.inf
        self._at_s = -math.inf

    def delay_s(self, stamp_s: float, arrived_s: float) -> float:
        """Time by which a message took longer than the fastest one so far, in s."""
        took_s = arrived_s - stamp_s
        if math.isfinite(self._at_s):
            self._fastest_s += self._drift * max(0.0, arrived_s - self._at_s)
        self._at_s = max(self._at_s, arrived_s)
        if took_s - self._fastest_s > self._other_clock_s:
            self._fastest_s = took_s
        self._fastest_s = min(self._fastest_s, took_s)
        return took_s - self._fastest_s


#: Later messages are dropped, if they have a stamp and no shorter time to live.
MOST_LATE_S = 0.5

#: Senders whose clocks are remembered.
MOST_SENDERS = 32


class StampCheck:
    """Drops late messages of one kind, each relative to the fastest one of its sender.

    Args:
        renewed_s: silence after which a sender may have another clock, in s.

    Attributes:
        late: number of dropped messages.
    """

    def __init__(self, renewed_s: float = math.inf, *, drift: float = DRIFT) -> None:
        self._renewed_s, self._drift = renewed_s, drift
        self._senders: OrderedDict[bytes, tuple[float, TransitDelay]] = OrderedDict()
        self.late = 0

    def admits(self, stamp_s: float | None, arrived_s: float, sender: bytes = b"") -> bool:
        """Whether a message is not late; `stamp_s` is None for one without a stamp, which never is."""
        if stamp_s is None:
            return True
        heard_s, transit = self._senders.pop(sender, (arrived_s, TransitDelay(drift=self._drift)))
        if arrived_s - heard_s > self._renewed_s:
            transit = TransitDelay(drift=self._drift)
        self._senders[sender] = arrived_s, transit
        if len(self._senders) > MOST_SENDERS:
            self._senders.popitem(last=False)
        late = transit.delay_s(stamp_s, arrived_s) > MOST_LATE_S
        self.late += late
        return not late
