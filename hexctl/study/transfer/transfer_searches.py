"""Searches in the landscapes of held-out worlds, trial by trial, as `hexctl adapt` would run them."""

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

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
from hexctl.study.landscape import PATH_STRIDE, Landscape
from hexctl.study.paper.evidence import clustered_error
from hexctl.study.paper.searches import curve_of
from hexctl.study.priors.prior_building import deflection_of
from hexctl.study.transfer.transfer_settings import EARLY, PRIORED, TransferSettings
from hexctl.types import FloatArray

if TYPE_CHECKING:
    from pandas import DataFrame


def search_worlds(
    plan: TransferSettings, landscapes: Sequence[Landscape], on_landscape: Callable[[], None] = lambda: None
) -> "DataFrame":
    """Run every optimizer in every landscape with a valid gait; a row for each run.

    Columns: place (number of the landscape), world, kind, leg, deviation of the best and the worst valid
    gait of the landscape, optimizer, run, and those of `run_course`. `on_landscape` is called after each
    landscape. Raises RobotFaultError if no gait is valid anywhere.
    """
    from pandas import DataFrame

    if not any(landscape.valid.any() for landscape in landscapes):
        raise RobotFaultError("transfer: no gait is valid in any world and leg; there is nothing to search")
    samples = {leg: samples_of(plan.prior, plan.robot, leg) for leg in plan.legs}
    rows: list[dict[str, Any]] = []
    for place, landscape in enumerate(landscapes):
        if not landscape.valid.any():
            continue
        found = {"place": place, "best_of_all_m": landscape.best_m, "worst_m": landscape.worst_m}
        rows += [found | row for row in _courses(plan, landscape, samples[landscape.spec.leg])]
        on_landscape()
    return DataFrame(rows)


def _courses(plan: TransferSettings, landscape: Landscape, samples: Samples) -> Iterator[dict[str, Any]]:
    spec = landscape.spec
    deflection_rad = None if plan.prior.sag_rad is None else deflection_of(spec)
    for name in plan.optimizers:
        for run in range(1 if name in PRIORED else plan.runs):
            search = make_search(plan, landscape, name, run, samples, deflection_rad)
            course = run_course(search, landscape, plan.budget, early=name == EARLY)
            head = {"world": spec.seed, "kind": plan.kind_of(spec), "leg": spec.leg}
            yield {**head, "optimizer": name, "run": run, **course}


def make_search(
    plan: TransferSettings,
    landscape: Landscape,
    optimizer: str,
    run: int,
    samples: Samples,
    deflection_rad: FloatArray | None = None,
) -> Optimizer:
    """Return the search of a run; some priors need `deflection_rad`, static and in the stance."""
    spec = landscape.spec
    seed = plan.seed_of(spec, run)
    if optimizer not in PRIORED:
        return Deduplication(make_optimizer(optimizer, spec.space, seed), seed)
    # No `uncertainty_m`: the simulated world stands for the robot here, and its walks are the truth.
    return Bayes(
        spec.space,
        seed,
        samples=samples,
        target_m=plan.target_m,
        duration_s=plan.duration_s,
        floor_m=progress_floor_m(plan.robot, spec.trial(1).plan, plan.duration_s),
        sag_rad=deflection_rad,
    )


def run_course(
    search: Optimizer, landscape: Landscape, budget: int, *, early: bool = False
) -> dict[str, Any]:
    """Run a search that looks up every walk in a landscape; `early` ends decided walks early.

    Returns:
        `codes`: the gaits walked, in order, (T,); fewer than the budget if the search was sure.
        `best_m`: deviation of the best gait after each trial, (budget,), constant after the last one; before
            a valid gait was found, that of the worst valid gait.
        `walked_s`: the time walked, likewise.
        `held`: whether each gait, walked out for the first time, ended inside its 90 % interval; empty for
            searches without predictions.
        `sure`: whether the search ended because it was sure of its target.
    """
    codes: list[int] = []
    bests, walked, held = [], [], []
    best_m, walked_s = landscape.worst_m, 0.0
    while len(codes) < budget and not search.finished and not search.exhausted:
        (code,) = search.ask(1)
        expected = search.predict(code)
        shown = walk_of(landscape, code, search.early_stopping(code) if early else None)
        row = landscape.row_of(code)
        if expected is not None and code not in codes and shown.finished:
            held.append(expected.holds(float(landscape.number("signed_m")[row])))
        score = float(landscape.scores[row]) if shown.status == "ok" else INVALID_SCORE
        search.tell([code], [score], [shown])
        codes.append(code)
        best_m, walked_s = min(best_m, score), walked_s + shown.duration_s
        bests.append(best_m)
        walked.append(walked_s)
    left = budget - len(codes)
    return {
        "codes": np.array(codes, dtype=np.int64),
        "best_m": np.array(bests + [best_m] * left),
        "walked_s": np.array(walked + [walked_s] * left),
        "held": np.array(held, dtype=bool),
        "sure": search.finished,
    }


def walk_of(landscape: Landscape, code: int, enough: Enough | None = None) -> Observation:
    """Walk of a gait as a session would observe it, cut short where early stopping ends it."""
    row = landscape.row_of(code)
    path = landscape.paths_m[row]
    path = path[np.isfinite(path[:, 0])].astype(float)
    point_s = PATH_STRIDE * PERIOD_S
    if enough is not None:
        # A point of the path stands for all ticks up to it; `enough` needs no more.
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


def trials_to(curve: "DataFrame", bound_m: float) -> int | None:
    """Return the number of trials after which the mean is within a bound; None if never."""
    within = curve.index[curve["mean_m"] <= bound_m]
    return int(within[0]) if len(within) else None


def by_seconds(runs: "DataFrame", seconds: FloatArray) -> "DataFrame":
    """Return the curve over seconds walked; until the first trial ends, the worst gait counts."""
    rows = []
    for run in runs.itertuples():
        done = np.searchsorted(run.walked_s[: len(run.codes)], seconds, side="right")
        rows.append(np.concatenate([[run.worst_m], run.best_m])[done])
    return curve_of(runs.assign(best_m=rows)).set_index(seconds)


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
