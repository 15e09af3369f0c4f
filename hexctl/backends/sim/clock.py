"""The simulation's clock: each tick steps the physics, as fast as it can or paced with the wall."""

from collections.abc import Callable

from hexctl.backends.clock import Clock, Tick, WallClock


class SimClock(Clock):
    """Makes the next tick come by stepping the physics one period.

    With a pace clock each step waits for the wall, whose overruns it counts; the simulation never skips.
    """

    def __init__(self, step: Callable[[], None], pace: WallClock | None = None) -> None:
        super().__init__()
        self._step = step
        self._pace = pace
        self._index = 0

    @property
    def now_s(self) -> float:
        """Return the simulated time."""
        return self._index * self.period_s

    @property
    def due_in_s(self) -> float:
        """Return how long the pace will wait before the next step; 0 without one."""
        return 0.0 if self._pace is None else self._pace.due_in_s

    def rest(self) -> None:
        """Count no overruns of the pace for the time until the next tick."""
        if self._pace is not None:
            self._pace.rest()

    def tick(self) -> Tick:
        """Step the physics by one period and return the new point in simulated time."""
        late_s = 0.0
        if self._pace is not None:
            late_s = self._pace.tick().late_s
            self.overruns = self._pace.overruns
        self._step()
        self._index += 1
        return Tick(self._index, self._index * self.period_s, late_s)
