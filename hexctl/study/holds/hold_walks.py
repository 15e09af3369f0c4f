"""The compared walks: simulated in chunks, and kept on disk."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from hexctl.control.batch import run_sim_trials
from hexctl.control.trial_result import STATUSES, TrialResult
from hexctl.gait.encoding import Slots
from hexctl.gait.gait import Gait
from hexctl.study.holds.hold_conditions import HoldCase, HoldConditions
from hexctl.study.holds.hold_plan import HoldPlan
from hexctl.study.landscapes.benchmark_walks import WalkCache
from hexctl.study.landscapes.benchmark_walks import walk_all as all_walks
from hexctl.study.landscapes.cache import LandscapeCache
from hexctl.study.landscapes.evaluate import Progress

#: Statuses of walks that end on their feet and have a final deviation.
ENDED = ("ok", "no_progress")


@dataclass(frozen=True, slots=True, kw_only=True)
class HoldWalk:
    """The outcome of one walk; deviations are those of the simulation's true pose, NaN where unknown.

    Attributes:
        case: what failed and what was held.
        slots: of the gait.
        body_raise: of the gait's posture, as a fraction of the robot's size.
        held: what the walk held.
        status: as in `hexctl.control.trial_result.STATUSES`.
        why: why it was stopped, or the likely cause of a walk without progress; None for neither.
        duration_s: how long it walked.
        signed_m: deviation at the end, positive to the left.
        mean_m: mean of the absolute deviation on the way.
        max_m: greatest absolute deviation on the way.
        distance_m: progress along the line.
        ideal_distance_m: of a robot whose feet do not slip.
        yaw_change_rad: how far the body turned.
        clipped_ticks: ticks in which the guard changed the targets.
    """

    case: HoldCase
    slots: Slots
    body_raise: float
    held: str
    status: str
    why: str | None
    duration_s: float
    signed_m: float
    mean_m: float
    max_m: float
    distance_m: float
    ideal_distance_m: float
    yaw_change_rad: float
    clipped_ticks: int

    @classmethod
    def of(cls, case: HoldCase, gait: Gait, result: TrialResult) -> "HoldWalk":
        """Outcome of a case from the gait and the result of its trial."""
        off = result.true_deviation
        signed_m, mean_m, max_m = (math.nan,) * 3 if off is None else (off.signed, off.mean, off.max)
        return cls(
            case=case,
            slots=gait.slots,
            body_raise=float(gait.posture.body_raise),
            held=result.hold,
            status=result.status,
            why=result.stopped or result.cause,
            duration_s=float(result.duration_s),
            signed_m=float(signed_m),
            mean_m=float(mean_m),
            max_m=float(max_m),
            distance_m=_known(result.distance_m),
            ideal_distance_m=float(result.ideal_distance_m),
            yaw_change_rad=_known(result.yaw_change_rad),
            clipped_ticks=int(result.clipped_ticks),
        )

    @property
    def final_m(self) -> float:
        """Final deviation in m; NaN for a walk that did not end on its feet."""
        return abs(self.signed_m) if self.status in ENDED else math.nan

    @property
    def speed(self) -> float:
        """Progress as a share of the ideal; NaN for a walk that did not end on its feet."""
        return self.distance_m / self.ideal_distance_m if self.status in ENDED else math.nan


def _known(value: float | None) -> float:
    return math.nan if value is None else float(value)


def walk_cases(conditions: HoldConditions, cases: Sequence[HoldCase], threads: int = 1) -> list[HoldWalk]:
    """Walks of some cases, stepped together."""
    trials = [conditions.trial(case) for case in cases]
    results = run_sim_trials(trials, threads)
    return [
        HoldWalk.of(case, trial.plan.gait, result)
        for case, trial, result in zip(cases, trials, results, strict=True)
    ]


class HoldCache(WalkCache[HoldConditions, HoldCase, HoldWalk]):
    """Walks on disk, a file for each robot and world.

    Args:
        landscapes: cache beside which they are, which takes the notes on files that are not usable.
    """

    def __init__(self, landscapes: LandscapeCache) -> None:
        super().__init__(landscapes, name="hold", read=_walk_from)


def _walk_from(values: dict[str, Any]) -> HoldWalk:
    """Walk of its values in a file; raises ValueError for what no simulation gives."""
    walk = HoldWalk(**values | {"case": HoldCase(**values["case"]), "slots": tuple(values["slots"])})
    numbers = (walk.signed_m, walk.max_m, walk.distance_m, walk.ideal_distance_m)
    if walk.status not in STATUSES or not all(isinstance(value, float) for value in numbers):
        raise ValueError("it has values that no simulation gives")
    if walk.status in ENDED and not all(map(math.isfinite, numbers)):
        raise ValueError("it has walks without an end")
    return walk


def walk_all(
    plan: HoldPlan, cache: HoldCache, progress: Progress, jobs: int | None = None
) -> list[tuple[HoldConditions, HoldWalk]]:
    """All walks of a plan, hold by hold in each world, kept as `benchmark_walks.walk_all` keeps them."""
    return all_walks(plan.walked(), cache, walk_cases, lambda case: case.hold, progress, jobs)
