"""Everything a transfer benchmark has found, and the figures that are asked of it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hexctl.adapt.prior.samples import samples_of
from hexctl.errors import RobotFaultError
from hexctl.study.landscape import Landscape
from hexctl.study.prior.stances import sag_of
from hexctl.study.transfer.course import Course, run_course
from hexctl.study.transfer.plan import PRIORED, TransferPlan
from hexctl.types import FloatArray

#: Deviations that are asked for.
NEAR_M, NEARER_M = 0.10, 0.025

OnLandscape = Callable[[Landscape], None]


@dataclass(frozen=True, kw_only=True)
class Curves:
    """Best deviation over all runs in all landscapes, after each trial or second, in m.

    Attributes:
        mean: over the runs.
        median: over the runs.
        p90: nine of ten runs are below.
    """

    mean: FloatArray
    median: FloatArray
    p90: FloatArray

    @classmethod
    def of(cls, best_m: FloatArray) -> "Curves":
        """Return the curves of best deviations, (runs, points)."""
        return cls(
            mean=best_m.mean(axis=0),
            median=np.median(best_m, axis=0),
            p90=np.percentile(best_m, 90, axis=0),
        )

    def trials_to(self, bound_m: float) -> int | None:
        """Return after how many trials the mean is within a bound, or None."""
        within = np.flatnonzero(self.mean <= bound_m)
        return int(within[0]) + 1 if within.size else None


@dataclass(frozen=True, kw_only=True)
class TransferFindings:
    """The results of one benchmark.

    Attributes:
        plan: what was asked.
        landscapes: those with at least one valid gait.
        without: how many have none, and are left out.
        courses: by place in `landscapes` and optimizer, one for each run.
    """

    plan: TransferPlan
    landscapes: list[Landscape]
    without: int
    courses: dict[tuple[int, str], list[Course]]

    def places(self, kind: str | None = None, *, reachable_m: float = np.inf) -> list[int]:
        """Return the places of the landscapes of a kind whose best gait is near enough."""
        return [
            place
            for place, landscape in enumerate(self.landscapes)
            if kind in (None, self.plan.kind_of(landscape.spec)) and landscape.best_m <= reachable_m
        ]

    def kinds(self) -> list[str]:
        """Return the kinds of worlds, in the order of their first appearance."""
        return list(dict.fromkeys(self.plan.kind_of(landscape.spec) for landscape in self.landscapes))

    def by_trials(self, optimizer: str, places: Sequence[int]) -> Curves:
        """Return the curves over trials."""
        return Curves.of(np.array([course.best_m for course in self._courses(optimizer, places)]))

    def by_seconds(self, optimizer: str, places: Sequence[int], seconds: FloatArray) -> Curves:
        """Return the curves over seconds walked; before the first trial is over the worst gait counts."""
        rows = []
        for place in places:
            worst_m = float(self.landscapes[place].final_m[self.landscapes[place].valid].max())
            for course in self.courses[place, optimizer]:
                done = np.searchsorted(course.walked_s[: len(course.codes)], seconds, side="right")
                rows.append(np.concatenate([[worst_m], course.best_m])[done])
        return Curves.of(np.array(rows))

    def floor_m(self, places: Sequence[int]) -> float:
        """Return the mean of the best gait of all: no search can be below."""
        return float(np.mean([self.landscapes[place].best_m for place in places]))

    def coverage(self, optimizer: str, places: Sequence[int]) -> tuple[float, int]:
        """Return which share of outcomes lay in their interval for nine of ten, and of how many."""
        held = np.concatenate([course.held for course in self._courses(optimizer, places)])
        return (float(held.mean()) if held.size else float("nan")), int(held.size)

    def sure_share(self, optimizer: str, places: Sequence[int]) -> tuple[float, float]:
        """Return the share of runs that ended sure of their target, and their mean trials."""
        courses = self._courses(optimizer, places)
        trials = [len(course.codes) for course in courses if course.sure]
        return len(trials) / len(courses), float(np.mean(trials)) if trials else float("nan")

    def _courses(self, optimizer: str, places: Sequence[int]) -> list[Course]:
        return [course for place in places for course in self.courses[place, optimizer]]


def run_transfer(
    plan: TransferPlan, landscapes: Sequence[Landscape], on_landscape: OnLandscape = lambda _: None
) -> TransferFindings:
    """Run every optimizer in every landscape."""
    usable = [landscape for landscape in landscapes if landscape.valid.any()]
    if not usable:
        raise RobotFaultError("transfer: no gait is valid in any world and leg; there is nothing to search")
    samples = {leg: samples_of(plan.prior, plan.robot, leg) for leg in plan.legs}
    courses = {}
    for place, landscape in enumerate(usable):
        spec = landscape.spec
        sag_rad = None if plan.prior.sag_rad is None else sag_of(spec)
        for name in plan.optimizers:
            known = samples[spec.leg] if name in PRIORED else None
            courses[place, name] = [
                run_course(plan, landscape, name, run, known, sag_rad) for run in range(plan.runs_of(name))
            ]
        on_landscape(landscape)
    return TransferFindings(
        plan=plan, landscapes=usable, without=len(landscapes) - len(usable), courses=courses
    )
