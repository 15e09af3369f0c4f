"""The course of one search in one landscape, trial by trial, as `hexctl adapt` would have gone."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hexctl.adapt.bayes import Bayes
from hexctl.adapt.catalogue import make_optimizer
from hexctl.adapt.counting import FreshCodes
from hexctl.adapt.objective import INVALID_SCORE
from hexctl.adapt.optimizer import Optimizer
from hexctl.adapt.prior.samples import Samples
from hexctl.adapt.shown import Shown
from hexctl.backends.clock import PERIOD_S
from hexctl.control.result import progress_floor_m
from hexctl.control.trial import LOOK_TICKS, Enough
from hexctl.study.landscape import PATH_STRIDE, Landscape
from hexctl.study.transfer.plan import EARLY, PRIORED, TransferPlan
from hexctl.types import BoolArray, FloatArray


@dataclass(frozen=True, kw_only=True)
class Course:
    """One run.

    Attributes:
        codes: what was walked, in order; shorter than the budget when the search was sure, (T,).
        best_m: deviation of the best gait after each trial of the budget, the last one going on, (B,); the
            worst of all valid gaits as long as none was found.
        walked_s: seconds walked by then, (B,).
        held: of the gaits walked for the first time, whether they ended in the interval that was to hold nine
            of ten; empty for searches that expect nothing.
        sure: whether the search ended because it was sure.
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
    sag_rad: FloatArray | None = None,
) -> Course:
    """Return the course of one run of an optimizer that looks up every walk in a landscape.

    `sag_rad` is how the robot stands there, for optimizers with a prior that knows how robots stand.
    """
    search = _search(plan, landscape, optimizer, run, samples)
    if sag_rad is not None and isinstance(search, Bayes):
        search.stood(sag_rad)
    codes: list[int] = []
    bests, walked, held = [], [], []
    best_m, walked_s = float(landscape.final_m[landscape.valid].max()), 0.0
    while len(codes) < plan.budget and not search.finished and not search.exhausted:
        (code,) = search.ask(1)
        expected = search.expect(code)
        shown = walk_of(landscape, code, search.enough(code) if optimizer == EARLY else None)
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


def walk_of(landscape: Landscape, code: int, enough: Enough | None = None) -> Shown:
    """Return a gait's walk as a session would have seen it, cut short where it has shown enough."""
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
                return Shown(
                    path_m=path[:points], duration_s=seconds, yaw_change_rad=None, status="cut_short"
                )
    yaw_rad = float(landscape.number("yaw_change_rad")[row])
    return Shown(
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
        return FreshCodes(make_optimizer(optimizer, landscape.spec.space, seed), seed)
    assert samples is not None  # noqa: S101  only bayes needs them, and gets them
    return Bayes(
        landscape.spec.space,
        seed,
        samples=samples,
        target_m=plan.target_m,
        duration_s=plan.duration_s,
        floor_m=progress_floor_m(plan.robot, landscape.spec.trial(1).plan, plan.duration_s),
    )
