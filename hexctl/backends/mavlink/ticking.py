"""A clock that counts its ticks, around any other."""

from hexctl.backends.clock import Clock, Tick


class CountedClock(Clock):
    """Passes everything on to the clock inside.

    Attributes:
        ticks: ticks so far.
    """

    def __init__(self, clock: Clock) -> None:
        super().__init__(clock.period_s)
        self._clock = clock
        self.ticks = 0

    @property
    def now_s(self) -> float:
        """Return the time of the clock inside."""
        return self._clock.now_s

    @property
    def due_in_s(self) -> float:
        """Return how long the next tick would wait."""
        return self._clock.due_in_s

    def rest(self) -> None:
        """Count no overruns until the next tick."""
        self._clock.rest()

    def tick(self) -> Tick:
        """Wait for the next tick of the clock inside and count it."""
        tick = self._clock.tick()
        self.ticks += 1
        self.overruns = self._clock.overruns
        return tick
