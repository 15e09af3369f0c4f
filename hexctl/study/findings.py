"""Everything a study has found: landscapes and searches, and the means over legs and runs."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hexctl.study.convergence import Curve, Searches, curve_of, search_landscape
from hexctl.study.landscape import Landscape
from hexctl.study.plan import HEURISTICS, WITH, WITHOUT, StudyPlan

#: Is told after each leg how many legs were searched.
OnLeg = Callable[[int], None]


@dataclass(frozen=True, kw_only=True)
class Findings:
    """The results of one study.

    Attributes:
        plan: what was asked.
        landscapes: by leg and self-rotation.
        searches: by leg, optimizer, and whether repetitions count (the paper's count).
    """

    plan: StudyPlan
    landscapes: dict[tuple[int, str], Landscape]
    searches: dict[tuple[int, str, bool], Searches]

    @property
    def heuristics(self) -> list[str]:
        """Return the paper's optimizers that were run."""
        return [name for name in self.plan.optimizers if name in HEURISTICS]

    def without(self, leg: int) -> Landscape:
        """Return the landscape without self-rotation."""
        return self.landscapes[leg, WITHOUT]

    def rotated(self, leg: int) -> Landscape:
        """Return the landscape with self-rotation, in which the optimizers search."""
        return self.landscapes[leg, WITH]

    def mean_curve(self, optimizer: str, *, paper_count: bool) -> Curve:
        """Return the statistics over all legs and runs together."""
        best = [self.searches[leg, optimizer, paper_count].best_m for leg in self.plan.legs]
        return curve_of(np.concatenate(best))

    def mean_at(self, optimizer: str, evaluations: int, *, paper_count: bool) -> float:
        """Return the mean best-so-far over all legs and runs after so many evaluations, in m.

        Only runs that have found a valid gait by then are in it; NaN when the budget is smaller.
        """
        if evaluations > self.plan.budget:
            return float("nan")
        return float(self.mean_curve(optimizer, paper_count=paper_count).mean[evaluations - 1])


def search_all(plan: StudyPlan, landscapes: list[Landscape], on_leg: OnLeg = lambda _: None) -> Findings:
    """Run every optimizer on every leg, by both counts, and return all there is."""
    known = {(landscape.spec.leg, landscape.spec.self_rotation): landscape for landscape in landscapes}
    searches = {}
    for number, leg in enumerate(plan.legs, start=1):
        seeds = [plan.seed_of(leg, run) for run in range(plan.runs)]
        for optimizer in plan.optimizers:
            for search in search_landscape(known[leg, WITH], optimizer, seeds, plan.budget):
                searches[leg, optimizer, search.paper_count] = search
        on_leg(number)
    return Findings(plan=plan, landscapes=known, searches=searches)
