"""What a trial showed: more than the one number it is worth."""

from dataclasses import dataclass

import numpy as np

from hexctl.control.result import TrialResult
from hexctl.types import FloatArray

#: Trials that were over before their time, and so say nothing about their end.
UNFINISHED = ("fell", "diverged", "cut_short", "aborted")


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """The course of one walk.

    Attributes:
        path_m: progress and signed deviation, evenly spread over the walk, the last row at its end, (T, 2).
        duration_s: how long it walked.
        yaw_change_rad: how far the body turned, None where nobody knows.
        status: as in `hexctl.control.result.STATUSES`.
    """

    path_m: FloatArray
    duration_s: float
    yaw_change_rad: float | None
    status: str

    @classmethod
    def of(cls, result: TrialResult) -> "Shown":
        """Return what a result shows."""
        return cls(
            path_m=result.path_m,
            duration_s=result.duration_s,
            yaw_change_rad=result.yaw_change_rad,
            status=result.status,
        )

    @property
    def finished(self) -> bool:
        """Return whether the walk lasted as long as it was meant to."""
        return self.status not in UNFINISHED

    def at(self, times_s: FloatArray) -> FloatArray:
        """Return the rows of the path at some times since the start, NaN after the end, (len(times_s), 2)."""
        rows = np.full((len(times_s), 2), np.nan)
        if len(self.path_m) == 0:
            return rows
        index = np.rint(times_s / self.duration_s * len(self.path_m)).astype(int) - 1
        walked = (index >= 0) & (index < len(self.path_m))
        rows[walked] = self.path_m[index[walked]]
        return rows
