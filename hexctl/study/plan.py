"""Plans of simulations: checked settings and the walks they require."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Generic, Literal, TypeVar, get_args, get_origin, get_type_hints

from hexctl.backends.sim.world import DomainRandomization
from hexctl.control.batch import SimTrial
from hexctl.control.walks.turning import check_plan
from hexctl.errors import InputError, LimitError, ReachError, argument
from hexctl.options import Typed, check_fields
from hexctl.study.landscape import LandscapeSpec
from hexctl.study.study_options import ComputeOptions
from hexctl.study.walk_cache import WalkCache, Walked
from hexctl.study.walking import Progress, Silent, Work
from hexctl.types import N_LEGS

ResultT = TypeVar("ResultT")


@dataclass(frozen=True, kw_only=True)
class Plan(ABC):
    """Settings of simulations. The annotations of its fields have their types, choices and ranges."""

    def __post_init__(self) -> None:
        check_fields(self)

    @abstractmethod
    def walked(self) -> Walked:
        """Return the cases to walk, place by place."""

    def check(self) -> None:
        """Raise InputError for invalid settings, such as repeated values, before anything runs."""
        for name, flag, kind in _several(type(self)):
            item = get_args(kind)[0]
            known = get_args(item) if get_origin(item) is Literal else ()
            given = [str(getattr(one, "name", one)) for one in getattr(self, name)]
            check_each(flag, given, tuple(map(str, known)))


def _several(plan: type[Plan]) -> Iterator[tuple[str, str, Any]]:
    """Name, name of the option, and type of each field with several values."""
    for name, hint in get_type_hints(plan, include_extras=True).items():
        kind, *marks = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        if get_origin(kind) in (tuple, dict):
            yield name, next((mark.flag for mark in marks if isinstance(mark, Typed)), name), kind


@dataclass(frozen=True, kw_only=True)
class LandscapePlan(Plan):
    """Settings of simulations of landscapes."""

    @abstractmethod
    def specs(self) -> list[LandscapeSpec]:
        """Return the specs of all landscapes."""

    def walked(self) -> Walked:
        """Return the gaits to walk, landscape by landscape."""
        return [(spec, spec.codes) for spec in self.specs()]


def check_each(name: str, given: Iterable[str], known: tuple[str, ...] = ()) -> None:
    """Raise InputError unless there are values, each once, and all of them known."""
    among, given = f" of {', '.join(known)}" if known else "", list(given)
    fine = bool(given) and len(set(given)) == len(given) and (not known or set(given) <= set(known))
    check_setting(name, ",".join(given) or "none", fine, f"one or more{among}, each once")


def check_setting(name: str, got: object, valid: bool, allowed: str) -> None:
    """Raise InputError for a setting, by its name, unless something holds."""
    if not valid:
        raise InputError(f"{argument(name)}: got {got}; allowed: {allowed}")


def check_families(families: Mapping[str, DomainRandomization], option: str = "world") -> None:
    """Raise InputError for a family of worlds in which legs fail by themselves."""
    for name, family in families.items():
        check_setting(option, name, not family.failures, "a family without `failures`")


def check_walkable(title: str, trial: SimTrial) -> None:
    """Raise InputError for a trial whose gait the robot's legs cannot walk."""
    try:
        check_plan(trial.robot, trial.plan)
    except (ReachError, LimitError) as error:
        raise InputError(f"{trial.robot.name}, {title}: {error}") from error


def check_legs(legs: Sequence[int]) -> None:
    """Raise InputError for legs other than 1..6."""
    known = set(legs) <= set(range(1, N_LEGS + 1))
    check_setting("legs", ",".join(map(str, legs)), known, f"one or more of 1..{N_LEGS}, each once")


def check_walks(specs: Iterable[LandscapeSpec]) -> None:
    """Raise InputError for a robot that cannot walk the gaits; those of a leg have the same joint ranges."""
    for spec in specs:
        check_walkable(spec.title, spec.trial(spec.codes[0]))


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannedWork(Generic[ResultT]):
    """Planned simulations, not yet begun.

    Attributes:
        plan: a `Plan`, such as a `StudyPlan` or a `PriorPlan`.
        options: which computers simulate.
        begin: runs the plan.
    """

    plan: Any
    options: ComputeOptions
    begin: Callable[[Work], ResultT]

    def saved(self, cache: WalkCache) -> tuple[int, int]:
        """Return how many walks of the plan a cache has, and how many there are."""
        return cache.count(self.plan.walked())

    def run(self, *, cache: WalkCache | None = None, progress: Progress | None = None) -> ResultT:
        """Simulate the walks that the cache lacks, and return the result.

        Finished walks are saved: the next call continues an interrupted one.

        Args:
            cache: None is `runs/study-cache`.

        Raises the errors of `hexctl.study.experiment.Experiment.run`.
        """
        options = self.options
        return self.begin(
            Work(
                cache=cache or WalkCache(),
                jobs=options.jobs,
                dask=options.dask,
                progress=progress or Silent(),
            )
        )
