"""Searches in the landscapes of unseen worlds, trial by trial, as `hexctl adapt` would run them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.optimizer import Observation, Optimizer
from hexctl.adapt.optimizers.bayes import Bayes
from hexctl.adapt.optimizers.deduplication import Deduplication
from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.prior.samples import Samples, samples_of
from hexctl.backends.clock import PERIOD_S
from hexctl.control.assessment.score import progress_floor_m
from hexctl.control.trial import LOOK_TICKS, Enough
from hexctl.errors import RobotFaultError
from hexctl.study.landscapes.landscape import PATH_STRIDE, Landscape
from hexctl.study.prior_building import deflection_of
from hexctl.study.transfer.transfer_plan import EARLY, PRIORED, TransferPlan
from hexctl.study.verdicts.claim_evidence import clustered_error
from hexctl.types import ArrayFields, BoolArray, FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Course(ArrayFields):
    """One run of a search.

    Attributes:
        codes: the gaits walked, in order; fewer than the budget when the search was sure, (T,).
        best_m: deviation of the best gait after each trial of the budget, constant after the last trial,
            (B,); that of the worst valid gait as long as no valid one was found.
        walked_s: seconds walked by then, (B,).
        held: of the gaits walked for the first time, whether they ended inside their 90 % interval; empty for
            searches without predictions.
        sure: whether the search ended because it was sure of its target.
    """

    codes: NDArray[np.int64]
    best_m: FloatArray
    walked_s: FloatArray
    held: BoolArray
    sure: bool


def run_course(
    plan: TransferPlan,
    landscape: Landscape,
    optimizer: str,
    run: int,
    samples: Samples | None,
    deflection_rad: FloatArray | None = None,
) -> Course:
    """Course of one run of an optimizer that looks up every walk in a landscape.

    `deflection_rad` is the static deflection of the joints in the stance, for `bayes` with such a prior.
    """
    search = _search(plan, landscape, optimizer, run, samples)
    if deflection_rad is not None and isinstance(search, Bayes):
        search.observe_stance(deflection_rad)
    codes: list[int] = []
    bests, walked, held = [], [], []
    best_m, walked_s = float(landscape.final_m[landscape.valid].max()), 0.0
    while len(codes) < plan.budget and not search.finished and not search.exhausted:
        (code,) = search.ask(1)
        expected = search.predict(code)
        shown = walk_of(landscape, code, search.early_stopping(code) if optimizer == EARLY else None)
        row = landscape.row_of(code)
        if expected is not None and code not in codes and shown.finished:
            held.append(expected.holds(float(landscape.number("signed_m")[row])))
        score = float(landscape.scores[row]) if shown.status == "ok" else INVALID_SCORE
        search.tell([code], [score], [shown])
        codes.append(code)
        best_m, walked_s = min(best_m, score), walked_s + shown.duration_s
        bests.append(best_m)
        walked.append(walked_s)
    left = plan.budget - len(codes)
    return Course(
        codes=np.array(codes, dtype=np.int64),
        best_m=np.array(bests + [best_m] * left),
        walked_s=np.array(walked + [walked_s] * left),
        held=np.array(held, dtype=bool),
        sure=search.finished,
    )


def walk_of(landscape: Landscape, code: int, enough: Enough | None = None) -> Observation:
    """Walk of a gait as a session would observe it, cut short where early stopping ends it."""
    row = landscape.row_of(code)
    path = landscape.paths_m[row]
    path = path[np.isfinite(path[:, 0])].astype(float)
    point_s = PATH_STRIDE * PERIOD_S
    if enough is not None:
        # A point of the path stands for all ticks up to it, which is all that is asked of them here.
        per_look = LOOK_TICKS // PATH_STRIDE
        for points in range(per_look, len(path), per_look):
            if enough(np.repeat(path[:points], PATH_STRIDE, axis=0)):
                seconds = points * point_s
                return Observation(
                    path_m=path[:points], duration_s=seconds, yaw_change_rad=None, status="cut_short"
                )
    yaw_rad = float(landscape.number("yaw_change_rad")[row])
    return Observation(
        path_m=path,
        duration_s=len(path) * point_s,
        yaw_change_rad=yaw_rad if np.isfinite(yaw_rad) else None,
        status=str(landscape.status[row]),
    )


def _search(
    plan: TransferPlan, landscape: Landscape, optimizer: str, run: int, samples: Samples | None
) -> Optimizer:
    seed = plan.seed_of(landscape.spec, run)
    if optimizer not in PRIORED:
        return Deduplication(make_optimizer(optimizer, landscape.spec.space, seed), seed)
    assert samples is not None  # noqa: S101  only bayes needs them, and gets them
    # No `uncertainty_m`: the simulated world stands for the robot here, and its walks are what is true.
    return Bayes(
        landscape.spec.space,
        seed,
        samples=samples,
        target_m=plan.target_m,
        duration_s=plan.duration_s,
        floor_m=progress_floor_m(plan.robot, landscape.spec.trial(1).plan, plan.duration_s),
    )


#: Deviations that are asked for.
NEAR_M, NEARER_M = 0.10, 0.025

OnLandscape = Callable[[Landscape], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class Curves(ArrayFields):
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
        """Curves of best deviations, (runs, points)."""
        return cls(
            mean=best_m.mean(axis=0),
            median=np.median(best_m, axis=0),
            p90=np.percentile(best_m, 90, axis=0),
        )

    def trials_to(self, bound_m: float) -> int | None:
        """Number of trials after which the mean is within a bound; None if never."""
        within = np.flatnonzero(self.mean <= bound_m)
        return int(within[0]) + 1 if within.size else None


@dataclass(frozen=True, kw_only=True)
class TransferFindings:
    """The results of one benchmark.

    Attributes:
        plan: its settings.
        landscapes: those with at least one valid gait.
        without: number of landscapes without a valid gait, which are left out.
        courses: by place in `landscapes` and optimizer, one for each run.
    """

    plan: TransferPlan
    landscapes: list[Landscape]
    without: int
    courses: dict[tuple[int, str], list[Course]]

    def places(self, kind: str | None = None, *, reachable_m: float = np.inf) -> list[int]:
        """Places of the landscapes of a kind whose best gait is within `reachable_m`."""
        return [
            place
            for place, landscape in enumerate(self.landscapes)
            if kind in (None, self.plan.kind_of(landscape.spec)) and landscape.best_m <= reachable_m
        ]

    def kinds(self) -> list[str]:
        """Kinds of worlds, in the order of their first appearance."""
        return list(dict.fromkeys(self.plan.kind_of(landscape.spec) for landscape in self.landscapes))

    def by_trials(self, optimizer: str, places: Sequence[int]) -> Curves:
        """Curves over trials."""
        return Curves.of(np.array([course.best_m for course in self._courses(optimizer, places)]))

    def by_seconds(self, optimizer: str, places: Sequence[int], seconds: FloatArray) -> Curves:
        """Curves over seconds walked; until the first trial ends, the worst gait counts."""
        rows = []
        for place in places:
            worst_m = float(self.landscapes[place].final_m[self.landscapes[place].valid].max())
            for course in self.courses[place, optimizer]:
                done = np.searchsorted(course.walked_s[: len(course.codes)], seconds, side="right")
                rows.append(np.concatenate([[worst_m], course.best_m])[done])
        return Curves.of(np.array(rows))

    def floor_m(self, places: Sequence[int]) -> float:
        """Mean deviation of the best gaits of all, a lower bound of every search, in m."""
        return float(np.mean([self.landscapes[place].best_m for place in places]))

    def standard_error_m(self, optimizer: str, places: Sequence[int]) -> FloatArray:
        """Standard error over worlds of the mean after each trial, (B,), in m; NaN for a single world."""
        means_m = [
            np.mean([course.best_m for course in self.courses[place, optimizer]], axis=0) for place in places
        ]
        return self._error_m(places, np.array(means_m))

    def floor_error_m(self, places: Sequence[int]) -> float:
        """Standard error over worlds of `floor_m`, in m; NaN for a single world."""
        best_m = np.array([[self.landscapes[place].best_m] for place in places])
        return float(self._error_m(places, best_m)[0])

    def _error_m(self, places: Sequence[int], values_m: FloatArray) -> FloatArray:
        """Standard error over worlds, (points,), of the mean of values, (places, points)."""
        worlds = np.array([self.landscapes[place].spec.seed for place in places])
        return clustered_error(values_m, worlds)

    def coverage(self, optimizer: str, places: Sequence[int]) -> tuple[float, int]:
        """Share of outcomes inside their 90 % intervals, and the number of outcomes."""
        held = np.concatenate([course.held for course in self._courses(optimizer, places)])
        return (float(held.mean()) if held.size else float("nan")), int(held.size)

    def sure_share(self, optimizer: str, places: Sequence[int]) -> tuple[float, float]:
        """Share of runs that ended sure of their target, and their mean number of trials."""
        courses = self._courses(optimizer, places)
        trials = [len(course.codes) for course in courses if course.sure]
        return len(trials) / len(courses), float(np.mean(trials)) if trials else float("nan")

    def _courses(self, optimizer: str, places: Sequence[int]) -> list[Course]:
        return [course for place in places for course in self.courses[place, optimizer]]


def search_worlds(
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
        deflection_rad = None if plan.prior.sag_rad is None else deflection_of(spec)
        for name in plan.optimizers:
            known = samples[spec.leg] if name in PRIORED else None
            courses[place, name] = [
                run_course(plan, landscape, name, run, known, deflection_rad)
                for run in range(plan.runs_of(name))
            ]
        on_landscape(landscape)
    return TransferFindings(
        plan=plan, landscapes=usable, without=len(landscapes) - len(usable), courses=courses
    )
