"""What a study or a prior will simulate, planned and not yet begun."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from hexctl.study.landscapes.cache import LandscapeCache
from hexctl.study.landscapes.evaluate import Progress

ResultT = TypeVar("ResultT")


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannedWork(Generic[ResultT]):
    """Simulations that are planned and not yet begun.

    Attributes:
        plan: the plan, such as a `StudyPlan` or a `PriorPlan`.
        begin: runs the plan, with a `cache` and a `progress`, and returns the result.
        saved: how much of the plan a cache has, and how much there is in all.
        unit: what `saved` counts.
    """

    plan: Any
    begin: Callable[..., ResultT]
    saved: Callable[[LandscapeCache], tuple[int, int]]
    unit: str = "gaits"

    def run(self, *, cache: LandscapeCache | None = None, progress: Progress | None = None) -> ResultT:
        """Simulate what the cache lacks, and return the result.

        What is simulated is saved while this runs: a call that was interrupted is continued by the next one.

        Args:
            cache: of what was simulated before; None is the one of the command line, `runs/study-cache`.
            progress: observer.

        Raises what `hexctl.study.study.run_study` raises.
        """
        return self.begin(cache=cache, progress=progress)
