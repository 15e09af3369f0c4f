"""Delay of messages by two clocks that need not agree."""

import math
from collections import OrderedDict
from functools import partial

#: Bound on the relative drift of two monotonic clocks: 100 ppm each, up to 500 ppm while NTP slews one.
DRIFT = 1000e-6

#: The same for the ceramic resonator of a microcontroller.
BOARD_DRIFT = 0.02

#: Later messages are dropped, if they have a stamp and no shorter time to live.
MOST_LATE_S = 0.5

#: So long after the last message in time, everything that depends on it has stopped.
RENEWED_S = 10.0

#: Senders whose clocks are remembered.
MOST_SENDERS = 32


class TransitDelay:
    """Delay of each message relative to the fastest one so far.

    The sender has another clock after a delay above `other_clock_s`, or `renewed_s` after the last in time.
    """

    def __init__(
        self, other_clock_s: float = math.inf, renewed_s: float = math.inf, drift: float = DRIFT
    ) -> None:
        self._other_clock_s, self._renewed_s, self._drift = other_clock_s, renewed_s, drift
        self._fastest_s = math.inf
        self._at_s = self._in_time_at_s = -math.inf

    def delay_s(self, stamp_s: float, arrived_s: float) -> float:
        """Time by which a message took longer than the fastest one so far, in s."""
        took_s, lost_s = arrived_s - stamp_s, arrived_s - self._in_time_at_s
        if math.isfinite(self._at_s):
            self._fastest_s += self._drift * max(0.0, arrived_s - self._at_s)
        self._at_s = max(self._at_s, arrived_s)
        if took_s - self._fastest_s > self._other_clock_s or lost_s > self._renewed_s:
            self._fastest_s = took_s
        self._fastest_s = min(self._fastest_s, took_s)
        if took_s - self._fastest_s <= MOST_LATE_S:
            self._in_time_at_s = arrived_s
        return took_s - self._fastest_s


class StampCheck:
    """Drops late messages of one kind, each relative to the fastest one of its sender.

    Args:
        silent_s: silence after which a sender that is late has another clock, in s.
        renewed_s: as of `TransitDelay`.

    Attributes:
        late: number of dropped messages.
    """

    def __init__(self, silent_s: float = 2.0, renewed_s: float = math.inf, drift: float = DRIFT) -> None:
        self._silent_s, self._new = silent_s, partial(TransitDelay, renewed_s=renewed_s, drift=drift)
        self._senders: OrderedDict[bytes, tuple[float, float, TransitDelay]] = OrderedDict()
        self.late = 0

    def admits(self, stamp_s: float | None, arrived_s: float, sender: bytes = b"") -> bool:
        """Whether a message is not late; `stamp_s` is None for one without a stamp, which never is."""
        if stamp_s is None:
            return True
        heard_s, from_s, transit = self._senders.pop(sender, (arrived_s, arrived_s, self._new()))
        late = transit.delay_s(stamp_s, arrived_s) > MOST_LATE_S
        if late and arrived_s - heard_s > self._silent_s:
            # What a link has held back comes now: until that has passed, nothing is in time.
            from_s, transit = arrived_s + MOST_LATE_S, self._new()
            transit.delay_s(stamp_s, arrived_s)
        self._senders[sender] = arrived_s, from_s, transit
        if len(self._senders) > MOST_SENDERS:
            self._senders.popitem(last=False)
        late = late or arrived_s < from_s
        self.late += late
        return not late
