"""Trials without a robot: a made-up landscape that the loop walks."""

from pathlib import Path

import numpy as np

from hexctl.adapt.runner import WalkedTrial
from hexctl.adapt.sessions.session import SessionSpec
from hexctl.control.result import Deviation, TrialResult
from hexctl.control.trial import Enough
from hexctl.gait.encoding import Slots

SPEC = SessionSpec(failed_leg=5, optimizer="pso", budget=12, seed=3)


def result_of(deviation_m: float, status: str = "ok") -> TrialResult:
    """The result of a walk that ends so far to the left of the line."""
    path = np.linspace([0.0, 0.0], [4.0, deviation_m], 100)
    off = abs(deviation_m)
    return TrialResult(
        status=status,
        stopped="requested" if status == "aborted" else None,
        duration_s=30.0,
        turned_rad=0.0,
        distance_m=4.0,
        ideal_distance_m=4.455,
        deviation=Deviation(off, off / 2, off, deviation_m),
        yaw_change_rad=0.1,
        clipped_ticks=0,
        path_m=path,
    )


class Landscape:
    """Walks gaits by a formula, and can be cut off after a number of trials."""

    def __init__(self, *, cut_after: int | None = None) -> None:
        self.walked: list[int] = []
        self._cut_after = cut_after

    def __call__(self, index: int, code: int, slots: Slots, should_stop: Enough | None = None) -> WalkedTrial:
        if self._cut_after is not None and len(self.walked) >= self._cut_after:
            return WalkedTrial(result=result_of(0.0, "aborted"))
        self.walked.append(code)
        status = "no_progress" if code % 7 == 0 else "ok"
        return WalkedTrial(
            result=result_of((code - 60.3) / 40, status), recording=Path(f"trial-{index:03d}.rrd")
        )
