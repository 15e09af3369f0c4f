"""Trials of postures in a walk: which height of the body is the fastest, measured along the line.

After a change of gait the progress over two cycles is compared with the commanded one, as its share p. The
robot makes up for what it falls short: it walks at the multiple h of its pace,

    h' = h + 1 - p,    1 <= h <= MOST_HASTE

from the second window on: in the first one a robot still turns back to its line.

While p / h is small, at the mean h of a window, it glides to other postures, measures each in the same way,
and keeps the one with the largest p / h.
The result depends on dragging feet, friction and weak joints, which no model predicts.
"""

import math
from collections.abc import Sequence

from hexctl.control.walks.velocity_walk import glide_cycles
from hexctl.gait.gait import Gait

#: Cycles after a glide over which the speed is measured.
MEASURED_CYCLES = 2.0

#: Share of the commanded speed below which another posture is tried, and for how many windows in a row. A
#: trial costs 3 cycles: with a share of 0.55, 30 of 45 pairs of limp legs recovered in three hard worlds, and
#: 38 without trials.
SLOW, PATIENCE = 0.3, 2

#: Share of the commanded speed by which another posture must have been faster.
LEAST_GAIN = 0.05

#: Largest h: with it, the slowest pairs of limp legs on weak servos made 0.76 of their speed instead of 0.50.
MOST_HASTE = 1.5

#: Rise of h that is reported.
REPORTED_RISE = 0.1

#: Time constant that smooths the measured position, in cycles.
MEAN_CYCLES = 0.1

#: Cycles after which an unknown position no longer justifies a higher pace.
LOST_CYCLES = 1.0


class PostureTrial:
    """The trial of one robot that glides to the first of some gaits; one update in each control period.

    Args:
        cycle_ticks: control periods of a gait cycle.
        commanded_m: commanded distance in a control period.

    Attributes:
        haste: h, which changes by at most 1 in a cycle.
    """

    def __init__(self, gaits: Sequence[Gait], cycle_ticks: float, commanded_m: float) -> None:
        self._gaits, self._commanded_m = list(gaits), commanded_m
        self._mean_ticks = MEAN_CYCLES * cycle_ticks
        self._begin_tick = round(glide_cycles(gaits[0]) * cycle_ticks)
        self._ticks, self._lost_ticks = round(MEASURED_CYCLES * cycle_ticks), LOST_CYCLES * cycle_ticks
        self._tick, self._unknown_ticks, self._from_tick = 0, 0, 0
        #: Sum of h over the ticks of a window.
        self._hurried_ticks = 0.0
        self._measured_m, self._progress_m, self._from_m = math.nan, math.nan, math.nan
        #: Shares p / h of the commanded speed; unwalked gaits come first.
        self._shares, self._now, self._slow = [math.inf] * len(gaits), 0, 0
        self.haste, self._goal, self._most_change = 1.0, 1.0, 1.0 / cycle_ticks
        self._turned_back, self._reported = False, 1.0

    def update(self, progress_m: float) -> Gait | None:
        """Take the measured progress along the line, NaN if unknown; the gait to glide to now, or None.

        A window begins and ends with a known progress: a robot that loses its position is not slow. Progress
        equal to the last one counts as unknown: the sensor may be frozen.
        """
        self._tick, self._unknown_ticks = self._tick + 1, self._unknown_ticks + 1
        goal = 1.0 if self._unknown_ticks > self._lost_ticks else self._goal
        self.haste += min(self._most_change, max(-self._most_change, goal - self.haste))
        self._hurried_ticks += self.haste
        if not math.isfinite(progress_m) or progress_m == self._measured_m:
            return None
        self._measured_m = progress_m
        before_m = progress_m if math.isnan(self._progress_m) else self._progress_m
        share = 1 - math.exp(-self._unknown_ticks / self._mean_ticks)
        self._progress_m, self._unknown_ticks = before_m + share * (progress_m - before_m), 0
        if self._tick >= self._begin_tick and math.isnan(self._from_m):
            self._begin_window()
        ticks = self._tick - self._from_tick
        if math.isnan(self._from_m) or ticks < self._ticks:
            return None
        walked = (self._progress_m - self._from_m) / self._commanded_m
        return self._next(walked / ticks, walked / self._hurried_ticks)

    @property
    def gait(self) -> Gait:
        """The gait of the present posture."""
        return self._gaits[self._now]

    def rise(self) -> float | None:
        """The h that the robot goes to, if it is `REPORTED_RISE` above the last one reported; else None."""
        self._reported = min(self._reported, self._goal)
        if self._goal < self._reported + REPORTED_RISE:
            return None
        self._reported = self._goal
        return self._goal

    def _begin_window(self) -> None:
        self._from_tick, self._from_m, self._hurried_ticks = self._tick, self._progress_m, 0.0

    def _next(self, p: float, share: float) -> Gait | None:
        """The gait to change to after p of this one, and its share p / h; None keeps it."""
        self._begin_window()  # without a glide, the next one
        self._shares[self._now] = share
        if self._turned_back:
            self._goal = min(MOST_HASTE, max(1.0, self._goal + 1.0 - p))
        self._turned_back = True
        other = max(range(len(self._gaits)), key=lambda place: self._shares[place])
        self._slow = self._slow + 1 if share < SLOW else 0
        if self._slow < PATIENCE or self._shares[other] <= share + LEAST_GAIN:
            return None
        self._tick, self._from_m, self._slow, self._now = 0, math.nan, 0, other
        self._turned_back = False
        return self.gait
