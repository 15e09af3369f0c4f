"""Which positions of a robot are believed: those that it can have reached since the last one.

A tracking system that takes another object for the robot, a damaged message, or a frame that was set anew
makes a position jump. Steering would follow it, and a walk would be scored by it.
"""

import math

from hexctl.types import FloatArray

#: Faster than any robot of this kind walks, and than it is carried, in m/s.
MOST_SPEED_M_S = 5.0

#: What an estimate may correct itself by at once. Smaller jumps are left to steering, alone and in a batch.
MOST_CORRECTION_M = 2.0

#: No place on Earth is further from any origin on it.
MOST_M = 1e8

#: For how long a jump is told, in s: one of a single tick would be gone before it is read.
TOLD_S = 2.0


class PositionCheck:
    """Judges the positions of one robot, one after the other.

    A jump that stays is believed once the robot could have gone there, so that a frame that was set anew
    costs no more than the loss of the pose for a while.

    Attributes:
        doubted: positions so far that were not believed.
    """

    def __init__(self) -> None:
        self.doubted = 0
        self._last: list[float] | None = None
        self._last_at_s = 0.0
        self._doubted: list[float] | None = None
        self._doubted_at_s = -math.inf
        self._jump_m = 0.0

    def believes(self, position_world: FloatArray, now_s: float) -> bool:
        """Whether a position (3,) in m is one that the robot can have now, in s on any clock."""
        position = position_world.tolist()
        if self._last is None:
            step_m, most_m = max(map(abs, position)), MOST_M
        else:
            step_m = math.dist(position, self._last)
            most_m = MOST_CORRECTION_M + MOST_SPEED_M_S * max(0.0, now_s - self._last_at_s)
        if not step_m <= min(most_m, MOST_M):  # true for nan too
            if now_s - self._doubted_at_s > TOLD_S:
                self._jump_m = step_m
            self.doubted += position != self._doubted  # the same one is read again and again
            self._doubted, self._doubted_at_s = position, now_s
            return False
        self._last, self._last_at_s = position, now_s
        return True

    def doubt(self, now_s: float) -> str | None:
        """What to tell of a jump that has just been, the first of several; None without."""
        if now_s - self._doubted_at_s > TOLD_S:
            return None
        return f"the position jumped by {self._jump_m:.3g} m, which is not believed"

    def forget(self) -> None:
        """Take the next position as it is: the robot may have been carried anywhere, or is seen anew."""
        self._last = None
