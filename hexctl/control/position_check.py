"""Plausibility of positions: only those are accepted that the robot can have reached since the last one.

Positions jump if a tracking system confuses objects, a message is damaged, or a frame is reset.
"""

import math

from hexctl.types import FloatArray

#: Maximum speed in m/s, also if the robot is carried.
MOST_SPEED_M_S = 5.0

#: Maximum sudden correction of an estimate; steering handles smaller jumps.
MOST_CORRECTION_M = 2.0

#: Maximum distance from any origin on Earth.
MOST_M = 1e8

#: How long a jump is reported, in s: a report of a single tick would be missed.
TOLD_S = 2.0


class PositionCheck:
    """Checks the positions of one robot in sequence; counts doubted ones, accepts plausible later jumps."""

    def __init__(self) -> None:
        self.doubted = 0
        self._last: list[float] | None = None
        self._last_at_s = 0.0
        self._doubted: list[float] | None = None
        self._doubted_at_s = -math.inf
        self._jump_m = 0.0

    def believes(self, position_world: FloatArray, now_s: float) -> bool:
        """Whether a position (3,) in m is plausible at a time, in s on any clock."""
        position = position_world.tolist()
        if self._last is None:
            step_m, most_m = max(map(abs, position)), MOST_M
        else:
            step_m = math.dist(position, self._last)
            most_m = MOST_CORRECTION_M + MOST_SPEED_M_S * max(0.0, now_s - self._last_at_s)
        if not step_m <= min(most_m, MOST_M):  # true for nan too
            if now_s - self._doubted_at_s > TOLD_S:
                self._jump_m = step_m
            self.doubted += position != self._doubted  # the same one is read repeatedly
            self._doubted, self._doubted_at_s = position, now_s
            return False
        self._last, self._last_at_s = position, now_s
        return True

    def doubt(self, now_s: float) -> str | None:
        """Message about a recent jump, the first of several, or None."""
        if now_s - self._doubted_at_s > TOLD_S:
            return None
        return f"the position jumped by {self._jump_m:.3g} m, which is not believed"

    def forget(self) -> None:
        """Accept the next position as it is, for a robot that may have been carried."""
        self._last = None
