"""Searches in known landscapes: every optimizer, many seeded runs, no simulation."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.optimizers.deduplication import PATIENCE, Deduplication
from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.optimizers.population import POPULATION
from hexctl.adapt.space import GaitSpace
from hexctl.backends.sim.world import World
from hexctl.errors import InputError
from hexctl.study.landscapes.landscape import GaitWalk, Landscape
from hexctl.study.verdicts.claim_evidence import Claim, number
from hexctl.study.verdicts.experiments import landscape_by_symmetry
from hexctl.study.verdicts.verdict_uncertainty import StudyUncertainty
from hexctl.types import ArrayFields, FloatArray

if TYPE_CHECKING:
    from hexctl.study.study_plan import StudyPlan

#: The five optimizers of the paper, and the baseline.
HEURISTICS = ("pso", "psosp", "dps", "debest", "derand")
BASELINE = "random"

#: Self-rotation of the landscapes without one.
WITHOUT = "none"


@dataclass(frozen=True, kw_only=True, eq=False)
class Curve(ArrayFields):
    """Best-so-far over the runs of a search, after each evaluation, (B,) each, in m.

    A run that has found no valid gait yet has no best-so-far. It is left out of all five numbers, and
    `share` says how many of the runs are in them; they are NaN where it is 0.

    Attributes:
        mean: over the runs.
        std: standard deviation over the runs (of the runs themselves, not an estimate for others).
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


def mean_of(best_m: FloatArray) -> FloatArray:
    """Mean of best-so-far values, (R, B), over the runs that have one, (B,); NaN where none has."""
    known = np.isfinite(best_m)
    counts = known.sum(axis=0)
    sums = np.where(known, best_m, 0.0).sum(axis=0)
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)


def search_landscape(
    landscape: Landscape,
    optimizer: str,
    seeds: Sequence[int],
    budget: int,
    counts: Sequence[bool] = (False, True),
) -> list[Searches]:
    """Return the runs of an optimizer that looks up every gait, for each count: fresh and the paper's.

    With the paper's count only, the number of own codes is not determined (0). Raises InputError for a
    landscape that does not hold all gaits.
    """
    space, scores = landscape.spec.space, landscape.scores
    if len(scores) != space.size:
        raise InputError(f"{landscape.spec.title}: got {len(scores)} gaits; allowed: {space.size}")
    own = [codes_until_stuck(optimizer, space, seed, scores) if False in counts else 0 for seed in seeds]
    return [_searches(landscape, optimizer, seeds, budget, paper_count=count, own=own) for count in counts]


def _searches(
    landscape: Landscape,
    optimizer: str,
    seeds: Sequence[int],
    budget: int,
    *,
    paper_count: bool,
    own: Sequence[int],
) -> Searches:
    """Runs counted by one rule."""
    space, scores = landscape.spec.space, landscape.scores
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


#: Gaits of a robot that knows of no failure: its default one, and the tripod.
DEFAULT_GAITS = ("demo", "tripod")


@dataclass(frozen=True, slots=True, kw_only=True)
class DefaultWalk:
    """One walk with a default gait, under the conditions of a landscape.

    Attributes:
        gait: one of `DEFAULT_GAITS`.
        signed_m: deviation at the end, positive to the left; None if unknown.
    """

    leg: int
    gait: str
    status: str
    signed_m: float | None
    distance_m: float | None

    @classmethod
    def of(cls, leg: int, walk: GaitWalk) -> "DefaultWalk":
        """Return the walk of a leg."""
        ends = {"signed_m": number(walk.signed_m), "distance_m": number(walk.distance_m)}
        return cls(leg=leg, gait=str(walk.case), status=walk.status, **ends)

    @property
    def final_m(self) -> float | None:
        """Deviation at the end; None for an invalid walk."""
        return None if self.status != "ok" or self.signed_m is None else abs(self.signed_m)


#: Called after each leg with the number of legs that were searched.
OnLeg = Callable[[int], None]


@dataclass(frozen=True, kw_only=True)
class Findings:
    """The results of one study in one world, with those in the other worlds.

    Attributes:
        landscapes: by leg and self-rotation.
        searches: by leg, optimizer, and whether repetitions count (the paper's count).
        nearby: the results in worlds like this one, over which claims are judged, too.
        nulls: the searches of the heuristics in landscapes of random numbers, see `null_findings`.
        default_walks: walks with the gaits that the robot would use anyway.
        claims: the paper's claims, judged by the results.
        uncertainty: the simulation's own, of the walks.
    """

    plan: "StudyPlan"
    landscapes: dict[tuple[int, str], Landscape]
    searches: dict[tuple[int, str, bool], Searches]
    world: World
    nearby: tuple["Findings", ...] = ()
    nulls: tuple["Findings", ...] = ()
    default_walks: tuple[DefaultWalk, ...] = ()
    claims: tuple[Claim, ...] = ()
    uncertainty: StudyUncertainty = field(default_factory=StudyUncertainty)

    @property
    def worlds(self) -> tuple["Findings", ...]:
        """The results in each world, this one first."""
        return (self, *self.nearby)

    @property
    def heuristics(self) -> list[str]:
        """The paper's optimizers that were run."""
        return [name for name in self.plan.optimizers if name in HEURISTICS]

    @cached_property
    def searched(self) -> list[int]:
        """Legs whose landscapes were searched, ascending."""
        return sorted({leg for leg, _, _ in self.searches})

    @cached_property
    def experiments(self) -> tuple[tuple[int, ...], ...]:
        """Searched legs in groups: one experiment each, and one vote."""
        groups = self.plan.experiments(self.world, self.plan.self_rotation)
        some = [tuple(leg for leg in group if leg in self.searched) for group in groups]
        return tuple(group for group in some if group)

    @cached_property
    def judged(self) -> "Findings":
        """The same with the searches of one leg of each experiment, by which claims are judged.

        In worlds like this one and on random numbers no other leg is searched: a mean over the runs of all
        legs would be compared with means over fewer runs.
        """
        first = {group[0] for group in self.experiments}
        return replace(self, searches={key: one for key, one in self.searches.items() if key[0] in first})

    def defaults(self, leg: int) -> list[DefaultWalk]:
        """Walks of a failed leg with the gaits that the robot would use anyway."""
        return [walk for walk in self.default_walks if walk.leg == leg]

    def without(self, leg: int) -> Landscape:
        """Landscape without self-rotation."""
        return self.landscapes[leg, WITHOUT]

    def rotated(self, leg: int) -> Landscape:
        """Landscape with self-rotation, in which the optimizers search."""
        return self.landscapes[leg, self.plan.self_rotation]

    def mean_curve(self, optimizer: str, *, paper_count: bool) -> Curve:
        """Statistics over all searched legs and runs together."""
        best = [self.searches[leg, optimizer, paper_count].best_m for leg in self.searched]
        return curve_of(np.concatenate(best))

    def voted_curve(self, optimizer: str) -> FloatArray:
        """Mean best-so-far by the paper's count, one vote for each experiment, (B,), in m.

        Runs without a valid gait yet are left out; NaN where there is none, and for an optimizer that was not
        run.
        """
        votes = [
            mean_of(np.concatenate([self.searches[leg, optimizer, True].best_m for leg in group]))
            for group in self.experiments
            if all((leg, optimizer, True) in self.searches for leg in group)
        ]
        known = np.isfinite(votes).any(axis=0) if votes else np.zeros(self.plan.budget, dtype=bool)
        means = np.full(self.plan.budget, np.nan)
        if known.any():
            means[known] = np.nanmean(np.array(votes)[:, known], axis=0)
        return means


def search_all(plan: "StudyPlan", landscapes: list[Landscape], on_leg: OnLeg = lambda _: None) -> Findings:
    """Run every optimizer on every leg, by both counts; `on_leg` gets the number of finished legs.

    `landscapes` are those of `plan.specs()`, in their order. In the worlds like the plan's own one the
    searches are run by the paper's count alone, and so are those in random numbers.
    """
    left = iter(landscapes)
    by_world = [[next(left) for _ in specs] for specs in plan.specs_by_world()]
    findings, *nearby = [_search_world(plan, some, number, on_leg) for number, some in enumerate(by_world)]
    findings = replace(findings, nearby=tuple(nearby))
    return replace(findings, nulls=null_findings(findings))


def _search_world(plan: "StudyPlan", walked: list[Landscape], number: int, on_leg: OnLeg) -> Findings:
    """Searches in the landscapes of one world."""
    searches = {}
    rotated = [landscape for landscape in walked if landscape.spec.self_rotation == plan.self_rotation]
    for count, landscape in enumerate(rotated, start=1):
        leg = landscape.spec.leg
        seeds = [plan.seed_of(leg, run, number) for run in range(plan.runs)]
        for optimizer in plan.optimizers:
            counts = (True,) if number else (False, True)
            for search in search_landscape(landscape, optimizer, seeds, plan.budget, counts):
                searches[leg, optimizer, search.paper_count] = search
        if not number:
            on_leg(count)
    return Findings(
        plan=plan,
        landscapes=_of_all_legs(plan, walked),
        searches=searches,
        world=walked[0].spec.world,
    )


def _of_all_legs(plan: "StudyPlan", walked: list[Landscape]) -> dict[tuple[int, str], Landscape]:
    """Landscapes of all legs, those that were not walked as images of others."""
    known = {
        rotation: [landscape for landscape in walked if landscape.spec.self_rotation == rotation]
        for rotation in plan.rotations
    }
    return {
        (leg, rotation): landscape_by_symmetry(known[rotation], leg)
        for leg in plan.legs
        for rotation in plan.rotations
    }


#: How many landscapes of random numbers each landscape is compared with.
NULL_DRAWS = 19


def null_findings(findings: Findings, draws: int = NULL_DRAWS) -> tuple[Findings, ...]:
    """The searches of the heuristics in landscapes of random numbers, one `Findings` for each draw.

    In each draw the gaits of every landscape change places at random: the codes have the same scores, in an
    order that means nothing. What then still holds is true of any numbers that are as large.
    """
    random = np.random.default_rng([findings.plan.seed, 120])
    return tuple(
        replace(first, nearby=tuple(others))
        for first, *others in (
            [_null_of(one, number, random) for number, one in enumerate(findings.worlds)]
            for _ in range(draws)
        )
    )


def _null_of(findings: Findings, number: int, random: np.random.Generator) -> Findings:
    """Findings with permuted landscapes, one leg of each experiment."""
    plan = findings.plan
    landscapes, searches = dict(findings.landscapes), {}
    for leg, *_ in findings.experiments:
        landscape = landscapes[leg, plan.self_rotation] = permuted(findings.rotated(leg), random)
        seeds = [plan.seed_of(leg, run, number) for run in range(plan.runs)]
        for name in findings.heuristics:
            (search,) = search_landscape(landscape, name, seeds, plan.budget, (True,))
            searches[leg, name, True] = search
    return Findings(plan=plan, landscapes=landscapes, searches=searches, world=findings.world)


def permuted(landscape: Landscape, random: np.random.Generator) -> Landscape:
    """Landscape whose gaits have changed places at random."""
    order = random.permutation(len(landscape.codes))
    mixed = {name: getattr(landscape, name)[order] for name in ("status", "numbers", "paths_m")}
    return replace(landscape, **mixed)
