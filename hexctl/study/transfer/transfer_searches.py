"""Searches in the landscapes of unseen worlds, trial by trial, as `hexctl adapt` would run them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.optimizer import Observation, Optimizer
from hexctl.adapt.optimizers.bayes import Bayes
from hexctl.adapt.optimizers.deduplication import Deduplication
from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.optimizers.shipped import BAYES
from hexctl.adapt.prior.samples import Samples, samples_of
from hexctl.backends.clock import PERIOD_S
from hexctl.control.assessment.score import progress_floor_m
from hexctl.control.trial import LOOK_TICKS, Enough
from hexctl.errors import RobotFaultError
from hexctl.study.evidence import clustered_error
from hexctl.study.landscape import PATH_STRIDE, Landscape
from hexctl.study.prior_building import deflection_of
from hexctl.types import ArrayFields, BoolArray, FloatArray

if TYPE_CHECKING:
    from pandas import DataFrame

    from hexctl.study.transfer.transfer_plan import TransferPlan

#: `bayes` with early stopping.
EARLY = "bayes-early"

#: Optimizers that believe a prior.
PRIORED = (BAYES, EARLY)

OnLandscape = Callable[[Landscape], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class Course(ArrayFields):
    """One run of a search.

    Attributes:
        codes: the gaits walked, in order; fewer than the budget when the search was sure, (T,).
        best_m: deviation of the best gait after each trial of the budget, constant after the last trial,
            (B,); that of the worst valid gait as long as no valid one was found.
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
    plan: "TransferPlan",
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
    plan: "TransferPlan", landscape: Landscape, optimizer: str, run: int, samples: Samples | None
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


def search_worlds(
    plan: "TransferPlan", landscapes: Sequence[Landscape], on_landscape: OnLandscape = lambda _: None
) -> "DataFrame":
    """Run every optimizer in every landscape that has a valid gait; a row for each run.

    Columns: place (number of the landscape), world, kind, leg, optimizer, run, those of `Course`, and
    deviation of the best and the worst valid gait of the landscape. Raises RobotFaultError if no gait is
    valid anywhere.
    """
    from pandas import DataFrame

    if not any(landscape.valid.any() for landscape in landscapes):
        raise RobotFaultError("transfer: no gait is valid in any world and leg; there is nothing to search")
    samples = {leg: samples_of(plan.prior, plan.robot, leg) for leg in plan.legs}
    rows = []
    for place, landscape in enumerate(landscapes):
        if not landscape.valid.any():
            continue
        spec = landscape.spec
        deflection_rad = None if plan.prior.sag_rad is None else deflection_of(spec)
        where = {
            "place": place,
            "world": spec.seed,
            "kind": plan.kind_of(spec),
            "leg": spec.leg,
            "best_of_all_m": landscape.best_m,
            "worst_m": float(landscape.final_m[landscape.valid].max()),
        }
        for name in plan.optimizers:
            known = samples[spec.leg] if name in PRIORED else None
            for run in range(plan.runs_of(name)):
                course = run_course(plan, landscape, name, run, known, deflection_rad)
                values = {field.name: getattr(course, field.name) for field in fields(course)}
                rows.append({**where, "optimizer": name, "run": run, **values})
        on_landscape(landscape)
    return DataFrame(rows)


@dataclass(frozen=True, kw_only=True, eq=False)
class Curves(ArrayFields):
    """Best deviation over some runs, after each trial or second, in m: mean, median, 90th percentile."""

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
        """Number of trials after which the mean is within a bound; None if never."""
        within = np.flatnonzero(self.mean <= bound_m)
        return int(within[0]) + 1 if within.size else None


def by_trials(runs: "DataFrame") -> Curves:
    """Return the curves of some runs over trials."""
    return Curves.of(np.stack(runs["best_m"].to_list()))


def by_seconds(runs: "DataFrame", seconds: FloatArray) -> Curves:
    """Return the curves over seconds walked; until the first trial ends, the worst gait counts."""
    rows = []
    for run in runs.itertuples():
        done = np.searchsorted(run.walked_s[: len(run.codes)], seconds, side="right")
        rows.append(np.concatenate([[run.worst_m], run.best_m])[done])
    return Curves.of(np.array(rows))


def floor_m(runs: "DataFrame") -> tuple[float, float]:
    """Mean deviation of the best of all gaits, a lower bound of every search, and its standard error."""
    places = runs.drop_duplicates("place")
    best_m = places["best_of_all_m"].to_numpy()
    error_m = clustered_error(best_m[:, np.newaxis], places["world"].to_numpy())
    return float(np.mean(best_m)), float(error_m[0])


def standard_error_m(runs: "DataFrame") -> FloatArray:
    """Standard error over worlds of the mean after each trial, (B,), in m; NaN for a single world."""
    places = [some for _, some in runs.groupby("place", sort=False)]
    means_m = np.array([np.mean(some["best_m"].to_list(), axis=0) for some in places])
    return clustered_error(means_m, np.array([some["world"].iloc[0] for some in places]))


def coverage(runs: "DataFrame") -> tuple[float, int]:
    """Share of outcomes inside their 90 % intervals, and the number of outcomes."""
    held = np.concatenate(runs["held"].to_list())
    return (float(held.mean()) if held.size else float("nan")), int(held.size)


def sure_share(runs: "DataFrame") -> tuple[float, float]:
    """Share of runs that ended sure of their target, and their mean number of trials."""
    trials = [len(codes) for codes in runs["codes"][runs["sure"]]]
    return len(trials) / len(runs), float(np.mean(trials)) if trials else float("nan")


def walked_s(runs: "DataFrame") -> float:
    """Mean walking time of a run, in s."""
    return float(np.mean([seconds[-1] for seconds in runs["walked_s"]]))
