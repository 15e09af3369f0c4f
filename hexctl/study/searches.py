"""Searches in known landscapes: every optimizer, many seeded runs, no simulation."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hexctl.adapt.deduplication import PATIENCE, Deduplication
from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.population import POPULATION
from hexctl.adapt.registry import make_optimizer
from hexctl.adapt.space import GaitSpace
from hexctl.errors import InputError
from hexctl.study.landscape import Landscape
from hexctl.study.plan import HEURISTICS, WITH, WITHOUT, StudyPlan
from hexctl.types import ArrayFields, FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Curve(ArrayFields):
    """Best-so-far over the runs of a search, after each evaluation, (B,) each, in m.

    A run that has found no valid gait yet has no best-so-far. It is left out of all five numbers, and
    `share` says how many of the runs are in them; they are NaN where it is 0.

    Attributes:
        mean: over the runs.
        std: standard deviation over the runs (of the runs themselves, not an estimate for others).
        median: over the runs.
        p10: a tenth of the runs is below.
        p90: a tenth of the runs is above.
        share: of the runs that have found a valid gait.
    """

    mean: FloatArray
    std: FloatArray
    median: FloatArray
    p10: FloatArray
    p90: FloatArray
    share: FloatArray


@dataclass(frozen=True, eq=False)
class Searches(ArrayFields):
    """All runs of one optimizer in one landscape, counted by one rule.

    Attributes:
        leg: the failed leg.
        optimizer: its name.
        paper_count: True where repetitions cost an evaluation each, False where each code is paid for once.
        seeds: of the runs, (R,).
        codes: what was evaluated, 0 after the end of a run that had tried all codes, (R, B).
        scores: what it was worth, `INVALID_SCORE` for an invalid gait and after the end, (R, B).
        own_codes: distinct codes that the search itself asked for before it was stuck (see `Deduplication`),
            whatever the budget; all of the space for one that never is, (R,).
    """

    leg: int
    optimizer: str
    paper_count: bool
    seeds: NDArray[np.int64]
    codes: NDArray[np.int64]
    scores: FloatArray
    own_codes: NDArray[np.int64]

    @cached_property
    def best_m(self) -> FloatArray:
        """Best score so far in m, (R, B); NaN before the first valid gait."""
        best = np.minimum.accumulate(self.scores, axis=1)
        return np.where(best < INVALID_SCORE, best, np.nan)

    @cached_property
    def curve(self) -> Curve:
        """Statistics over the runs."""
        return curve_of(self.best_m)

    @property
    def best_codes(self) -> NDArray[np.int64]:
        """Best code of each run that found a valid one."""
        at = self.scores.argmin(axis=1)
        found = self.scores.min(axis=1) < INVALID_SCORE
        return np.array(self.codes[np.arange(len(at)), at][found])

    @property
    def distinct(self) -> NDArray[np.int64]:
        """Number of different codes that each run evaluated, (R,)."""
        return np.array([np.unique(run[run > 0]).size for run in self.codes])


def curve_of(best_m: FloatArray) -> Curve:
    """Statistics of best-so-far values, (R, B), over the runs; NaN stands for none yet."""
    share = np.isfinite(best_m).mean(axis=0)
    known = share > 0
    some = best_m[:, known]
    rows = [np.nanmean(some, axis=0), np.nanstd(some, axis=0)]
    rows += list(np.nanpercentile(some, [50, 10, 90], axis=0)) if known.any() else [some[0]] * 3
    filled = np.full((5, best_m.shape[1]), np.nan)
    filled[:, known] = rows
    mean, std, median, p10, p90 = filled
    return Curve(mean=mean, std=std, median=median, p10=p10, p90=p90, share=share)


def search_landscape(
    landscape: Landscape, optimizer: str, seeds: Sequence[int], budget: int
) -> tuple[Searches, Searches]:
    """Runs of an optimizer that looks up every gait in a landscape: by the fresh count and the paper's.

    Raises InputError for a landscape that does not hold all gaits.
    """
    space, scores = landscape.spec.space, landscape.scores
    if len(scores) != space.size or not landscape.complete:
        raise InputError(f"{landscape.spec.title}: got {landscape.done.sum()} gaits; allowed: {space.size}")
    own = [codes_until_stuck(optimizer, space, seed, scores) for seed in seeds]

    def search(paper_count: bool) -> Searches:
        runs = [_run(optimizer, space, seed, scores, budget, paper_count) for seed in seeds]
        codes = np.array(runs, dtype=np.int64).reshape(len(seeds), budget)
        return Searches(
            leg=landscape.spec.leg,
            optimizer=optimizer,
            paper_count=paper_count,
            seeds=np.array(seeds, dtype=np.int64),
            codes=codes,
            scores=np.where(codes > 0, scores[codes - 1], INVALID_SCORE),
            own_codes=np.array(own, dtype=np.int64),
        )

    return search(False), search(True)


def _run(
    optimizer: str, space: GaitSpace, seed: int, scores: FloatArray, budget: int, paper_count: bool
) -> list[int]:
    """Codes that one run evaluates, padded with 0.

    Codes are paid for one by one, as `hexctl adapt` does; where repetitions count the size of an ask does not
    matter, and a generation at a time is quicker.
    """
    together = POPULATION if paper_count else 1
    search = Deduplication(make_optimizer(optimizer, space, seed), seed, paper_count=paper_count)
    codes: list[int] = []
    while len(codes) < budget and not search.exhausted:
        asked = search.ask(min(together, budget - len(codes)))
        search.tell(asked, [float(scores[code - 1]) for code in asked])
        codes += asked
    return codes + [0] * (budget - len(codes))


def codes_until_stuck(optimizer: str, space: GaitSpace, seed: int, scores: FloatArray) -> int:
    """Number of distinct codes a search asks for until none of the next `PATIENCE` is fresh."""
    search = make_optimizer(optimizer, space, seed)
    tried: set[int] = set()
    stale = 0
    while stale < PATIENCE and len(tried) < space.size:
        (code,) = search.ask(1)
        search.tell([code], [float(scores[code - 1])])
        stale = stale + 1 if code in tried else 0
        tried.add(code)
    return len(tried)


#: Called after each leg with the number of legs that were searched.
OnLeg = Callable[[int], None]


@dataclass(frozen=True, kw_only=True)
class Findings:
    """The results of one study.

    Attributes:
        plan: its settings.
        landscapes: by leg and self-rotation.
        searches: by leg, optimizer, and whether repetitions count (the paper's count).
    """

    plan: StudyPlan
    landscapes: dict[tuple[int, str], Landscape]
    searches: dict[tuple[int, str, bool], Searches]

    @property
    def heuristics(self) -> list[str]:
        """The paper's optimizers that were run."""
        return [name for name in self.plan.optimizers if name in HEURISTICS]

    def without(self, leg: int) -> Landscape:
        """Landscape without self-rotation."""
        return self.landscapes[leg, WITHOUT]

    def rotated(self, leg: int) -> Landscape:
        """Landscape with self-rotation, in which the optimizers search."""
        return self.landscapes[leg, WITH]

    def mean_curve(self, optimizer: str, *, paper_count: bool) -> Curve:
        """Statistics over all legs and runs together."""
        best = [self.searches[leg, optimizer, paper_count].best_m for leg in self.plan.legs]
        return curve_of(np.concatenate(best))

    def mean_at(self, optimizer: str, evaluations: int, *, paper_count: bool) -> float:
        """Mean best-so-far over all legs and runs after a number of evaluations, in m.

        Only runs that have found a valid gait by then are in it; NaN when the budget is smaller.
        """
        if evaluations > self.plan.budget:
            return float("nan")
        return float(self.mean_curve(optimizer, paper_count=paper_count).mean[evaluations - 1])


def search_all(plan: StudyPlan, landscapes: list[Landscape], on_leg: OnLeg = lambda _: None) -> Findings:
    """Run every optimizer on every leg, by both counts; `on_leg` gets the number of finished legs."""
    known = {(landscape.spec.leg, landscape.spec.self_rotation): landscape for landscape in landscapes}
    searches = {}
    for number, leg in enumerate(plan.legs, start=1):
        seeds = [plan.seed_of(leg, run) for run in range(plan.runs)]
        for optimizer in plan.optimizers:
            for search in search_landscape(known[leg, WITH], optimizer, seeds, plan.budget):
                searches[leg, optimizer, search.paper_count] = search
        on_leg(number)
    return Findings(plan=plan, landscapes=known, searches=searches)
