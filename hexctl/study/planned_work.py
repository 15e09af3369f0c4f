"""A study or a prior that is planned and not yet simulated."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from hexctl.study.walk_cache import WalkCache
from hexctl.study.walking import Progress

ResultT = TypeVar("ResultT")


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannedWork(Generic[ResultT]):
    """Simulations that are planned and not yet begun.

    Attributes:
        plan: the plan, such as a `StudyPlan` or a `PriorPlan`, a `hexctl.study.plan.Plan`.
        begin: runs the plan, with a `cache` and a `progress`, and returns the result.
    """

    plan: Any
    begin: Callable[..., ResultT]

    def saved(self, cache: WalkCache) -> tuple[int, int]:
        """Return how many walks of the plan a cache has, and how many there are."""
        saved, total = cache.count(self.plan.walked())
        return saved, total

    def run(self, *, cache: WalkCache | None = None, progress: Progress | None = None) -> ResultT:
        """Simulate what the cache lacks, and return the result.

        Walks are saved while this runs: a call that was interrupted is continued by the next one.

        Args:
            cache: earlier walks; None is the one of the command line, `runs/study-cache`.
            progress: observer.

        Raises what `hexctl.study.experiment.Experiment.run` raises.
        """
        return self.begin(cache=cache, progress=progress)
