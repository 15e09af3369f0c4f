"""The leg probe: moves a tucked leg now and then, and checks whether its joints follow again."""

import math

import numpy as np

from hexctl.types import JOINTS_PER_LEG, FloatArray

#: Cycles from the tuck to the first try, and the factor of later intervals.
FIRST_CYCLES, LATER = 6.0, 1.5

#: Factor of the interval after a leg was considered intact and failed again.
AFTER_RELAPSE = 3.0

#: Duration of a try, in cycles.
LASTS_CYCLES = 1.0

#: Movement of the foot, sideways and up, as fractions of the robot's size.
SIDEWAYS, UP = 0.03, 0.015

#: Minimum slope of a joint that follows, and minimum standard deviation of its targets.
LEAST_GAIN, LEAST_MOTION_RAD = 0.6, math.radians(1.0)


class LegProbe:
    """Tries of one tucked leg; without `moves`, for a leg detected by its load, a due try succeeds."""

    def __init__(
        self, step: int, cycle_steps: float, *, moves: bool, first_cycles: float = FIRST_CYCLES
    ) -> None:
        self._cycle_steps, self._moves = cycle_steps, moves
        self._wait_steps = first_cycles * cycle_steps
        self._next = step + self._wait_steps
        self._rows: list[tuple[FloatArray, FloatArray]] = []

    def offset_m(self, step: int, size_m: float) -> FloatArray:
        """Offset of the foot from its place in the air at a step, in the body frame, (3,) in m."""
        cycles = (step - self._next) / self._cycle_steps
        if not (self._moves and 0 <= cycles < LASTS_CYCLES):
            return np.zeros(3)
        wave = math.sin(math.tau * cycles / LASTS_CYCLES)
        return size_m * np.array([SIDEWAYS * wave, SIDEWAYS * wave, UP * wave])

    def whole(self, step: int, targets_rad: FloatArray, measured_rad: FloatArray) -> bool:
        """Whether the leg has just proved to be intact, by its targets and measured angles, (3,)."""
        if step < self._next:
            return False
        if self._moves and step < self._next + LASTS_CYCLES * self._cycle_steps:
            self._rows.append((targets_rad.copy(), measured_rad.copy()))
            return False
        follows = not self._moves or self._follows()
        self._rows.clear()
        self._wait_steps *= LATER
        self._next = step + self._wait_steps
        return follows

    def _follows(self) -> bool:
        """Whether all moved joints followed: slope of the measured angles over the targets."""
        if not self._rows:  # its time passed while the leg was not in the air
            return False
        targets, measured = np.array(self._rows).swapaxes(0, 1) - np.mean(self._rows, axis=0)[:, np.newaxis]
        variance = (targets * targets).mean(axis=0)
        moved = variance > LEAST_MOTION_RAD**2
        gains = (targets * measured).mean(axis=0)[moved] / variance[moved]
        return len(gains) > JOINTS_PER_LEG // 2 and bool((gains > LEAST_GAIN).all())
