"""How much longer than usual a message was on its way, from the sender's stamps alone."""

#: Two clocks that never jump still drift apart, by less than this share: 100 ppm each for their crystals, and
#: up to 500 ppm for time services that slew one of them. A faster one (chrony may) makes commands late.
DRIFT = 1000e-6


class Transit:
    """Compares arrivals with the fastest so far: the clocks of the two ends need not agree.

    The first message counts as on time. Of a message that waited in a link that was cut, the delay shows.
    """

    def __init__(self) -> None:
        self._fastest_s: float | None = None
        self._at_s = 0.0

    def delay_s(self, stamp_s: float, arrived_s: float) -> float:
        """Return by how much a message took longer than the fastest one so far.

        Args:
            stamp_s: when it was sent, on the sender's clock.
            arrived_s: when it came, on the receiver's clock.
        """
        took_s = arrived_s - stamp_s
        if self._fastest_s is None:
            self._fastest_s, self._at_s = took_s, arrived_s
        self._fastest_s += DRIFT * max(0.0, arrived_s - self._at_s)
        self._at_s = max(self._at_s, arrived_s)
        self._fastest_s = min(self._fastest_s, took_s)
        return took_s - self._fastest_s
