"""Ends a walk before the robot is out of its arena."""

import numpy as np

from hexctl.adapt.arena import Arena
from hexctl.control.log import TickLog
from hexctl.control.trial import LOOK_TICKS, Enough
from hexctl.types import FloatArray

#: Why a walk was cut short.
LEFT_THE_ARENA = "arena"

#: A robot that is told to stop now goes on for as long as between two looks: the soft stop takes twice that,
#: at half the speed. And until the next look it is not told.
LOOKS_AHEAD = 2.0


class Fence:
    """Looks where the robot would come to a stand if nothing were said until the next look.

    Attributes:
        reached: whether that was outside.
    """

    def __init__(self, arena: Arena, log: TickLog, also: Enough | None = None) -> None:
        """Watch the walk that a log is of; `also` may end it for other reasons."""
        self.reached = False
        self._arena, self._log, self._also = arena, log, also

    def __call__(self, path_m: FloatArray) -> bool:
        """Return whether the walk shall end; the `Enough` of a trial."""
        now = len(self._log)
        rows = self._log.rows("base_position_world", max(0, now - LOOK_TICKS - 1), now)
        here, moved = rows[-1], rows[-1] - rows[0]
        self.reached = bool(np.isfinite(moved).all()) and self._arena.leaves(here, here + LOOKS_AHEAD * moved)
        return self.reached or (self._also is not None and self._also(path_m))
