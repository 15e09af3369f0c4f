"""Searches in known landscapes: every optimizer, many seeded runs, no simulation."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.optimizers.deduplication import Deduplication
from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.optimizers.population import POPULATION
from hexctl.adapt.space import GaitSpace
from hexctl.study.experiment import where
from hexctl.study.landscape import Landscape
from hexctl.study.paper.evidence import Claim
from hexctl.study.paper.leg_groups import landscape_by_symmetry
from hexctl.study.paper.study_plan import HEURISTICS, WITHOUT, StudyPlan
from hexctl.types import FloatArray

if TYPE_CHECKING:
    from pandas import DataFrame

#: Number of landscapes of random numbers that each landscape is compared with.
NULL_DRAWS = 19

#: Leg of the statistics over all legs.
ALL = 0

#: One row of a table.
Row = dict[str, Any]


def search_landscape(
    landscape: Landscape,
    optimizer: str,
    seeds: Sequence[int],
    budget: int,
    scores: FloatArray | None = None,
) -> list[Row]:
    """Return the runs of an optimizer that looks up every gait, a row for each seed; repeated codes count.

    Columns: optimizer, seed; `codes`, in order of evaluation, 0 after the end of a run that had tried all,
    (budget,); `scores` of these, `INVALID_SCORE` for an invalid gait and after the end; `best_m`, the best
    score so far in m, NaN before the first valid gait. `scores` replace those of the landscape.
    """
    space, scores = landscape.spec.space, landscape.scores if scores is None else scores
    return [
        {"optimizer": optimizer, "seed": seed} | _run(optimizer, space, seed, scores, budget)
        for seed in seeds
    ]


def _run(optimizer: str, space: GaitSpace, seed: int, scores: FloatArray, budget: int) -> Row:
    """Codes and scores of one run. If repetitions count, asking for a generation at a time is quicker."""
    search = Deduplication(make_optimizer(optimizer, space, seed), seed, paper_count=True)
    codes: list[int] = []
    while len(codes) < budget and not search.exhausted:
        asked = search.ask(min(POPULATION, budget - len(codes)))
        search.tell(asked, [float(scores[code - 1]) for code in asked])
        codes += asked
    padded = np.array(codes + [0] * (budget - len(codes)), dtype=np.int64)
    found = np.where(padded > 0, scores[padded - 1], INVALID_SCORE)
    best = np.minimum.accumulate(found)
    return {"codes": padded, "scores": found, "best_m": np.where(best < INVALID_SCORE, best, np.nan)}


def curve_of(runs: "DataFrame") -> "DataFrame":
    """Return statistics of the best score so far over some runs, a row for each evaluation, in m.

    Runs without a valid gait yet are left out; `share_of_runs` is the share of the others.
    """
    from pandas import DataFrame

    best_m = DataFrame(np.stack(runs["best_m"].to_list()))
    best_m.columns = best_m.columns + 1
    columns = {"mean_m": best_m.mean(), "std_m": best_m.std(ddof=0), "median_m": best_m.median()}
    percentiles = {"p10_m": best_m.quantile(0.1), "p90_m": best_m.quantile(0.9)}
    return DataFrame(columns | percentiles | {"share_of_runs": best_m.notna().mean()})


@dataclass(frozen=True, kw_only=True, eq=False)
class Findings:
    """The results of one study.

    Attributes:
        landscapes: by world, leg and self-rotation; world 0 is that of the plan.
        runs: rows of `search_landscape`, with `world`, `leg` and `draw`: 0 for searches in the landscapes,
            other numbers for those in random numbers, see `null_runs`.
    """

    plan: StudyPlan
    landscapes: dict[tuple[int, int, str], Landscape]
    runs: "DataFrame"
    claims: tuple[Claim, ...] = ()

    @property
    def worlds(self) -> range:
        """Numbers of the worlds."""
        return range(self.plan.worlds)

    @property
    def heuristics(self) -> list[str]:
        """The paper's optimizers in this study."""
        return [name for name in self.plan.optimizers if name in HEURISTICS]

    @cached_property
    def first_runs(self) -> "DataFrame":
        """Runs in the landscapes of the first world."""
        return where(self.runs, draw=0, world=0)

    @cached_property
    def searched(self) -> list[int]:
        """Legs whose landscapes were searched, ascending."""
        return sorted(self.first_runs["leg"].unique().tolist())

    @cached_property
    def experiments(self) -> tuple[tuple[int, ...], ...]:
        """Legs in groups: one experiment and one vote each. The first leg of each is searched."""
        return self.plan.experiments(self.plan.world, self.plan.self_rotation)

    def without(self, leg: int, world: int = 0) -> Landscape:
        """Return a landscape without self-rotation."""
        return self.landscapes[world, leg, WITHOUT]

    def rotated(self, leg: int, world: int = 0) -> Landscape:
        """Return a landscape with self-rotation, in which the optimizers search."""
        return self.landscapes[world, leg, self.plan.self_rotation]

    @cached_property
    def curves(self) -> "dict[tuple[int, str], DataFrame]":
        """Statistics in the first world by leg and optimizer; leg `ALL` is all of them together."""
        runs = self.first_runs
        by_leg = {key: curve_of(some) for key, some in runs.groupby(["leg", "optimizer"], sort=False)}
        of_all = {(ALL, name): curve_of(some) for name, some in runs.groupby("optimizer", sort=False)}
        return by_leg | of_all


def search_all(
    plan: StudyPlan, landscapes: Sequence[Landscape], on_leg: Callable[[], None] = lambda: None
) -> Findings:
    """Run every optimizer on every leg; `on_leg` is called after each leg.

    `landscapes` are those of `plan.specs()`, in their order.
    """
    from pandas import DataFrame, concat

    known: dict[tuple[int, int, str], Landscape] = {}
    left, rows = iter(landscapes), list[Row]()
    for world, specs in enumerate(plan.specs_by_world()):
        walked = [next(left) for _ in specs]
        known |= {(world, *key): one for key, one in _of_all_legs(plan, walked).items()}
        for landscape in walked:
            if landscape.spec.self_rotation == plan.self_rotation:
                rows += _searches(plan, landscape, world, plan.optimizers)
                if not world:
                    on_leg()
    found = Findings(plan=plan, landscapes=known, runs=DataFrame(rows).assign(draw=0))
    nulls = DataFrame(null_runs(found))
    return found if nulls.empty else replace(found, runs=concat([found.runs, nulls], ignore_index=True))


def _searches(
    plan: StudyPlan,
    landscape: Landscape,
    world: int,
    optimizers: Sequence[str],
    scores: FloatArray | None = None,
) -> Iterator[Row]:
    leg = landscape.spec.leg
    seeds = [plan.seed_of(leg, run, world) for run in range(plan.runs)]
    for name in optimizers:
        for row in search_landscape(landscape, name, seeds, plan.budget, scores):
            yield {"world": world, "leg": leg, **row}


def _of_all_legs(plan: StudyPlan, walked: Sequence[Landscape]) -> dict[tuple[int, str], Landscape]:
    """Landscapes of all legs; those not simulated are images of others."""
    return {
        (leg, rotation): landscape_by_symmetry(
            [landscape for landscape in walked if landscape.spec.self_rotation == rotation], leg
        )
        for leg in plan.legs
        for rotation in plan.rotations
    }


def null_runs(findings: Findings) -> Iterator[Row]:
    """Run the heuristics in landscapes of random numbers: the same scores, assigned to random codes.

    A claim that holds there would hold for any numbers of this size.
    """
    random = np.random.default_rng([findings.plan.seed, 120])
    for draw in range(1, NULL_DRAWS + 1):
        for world in findings.worlds:
            for leg, *_ in findings.experiments:
                landscape = findings.rotated(leg, world)
                scores = landscape.scores[random.permutation(len(landscape.codes))]
                for row in _searches(findings.plan, landscape, world, findings.heuristics, scores):
                    yield row | {"draw": draw}
