"""Settings of a study: legs, optimizers, runs and evaluations."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

from hexctl.adapt.registry import make_optimizer
from hexctl.adapt.space import GaitSpace
from hexctl.backends.sim.world import World
from hexctl.control.turning import check_plan
from hexctl.errors import InputError, LimitError, ReachError, argument, check_type
from hexctl.robot.model import Robot
from hexctl.study.landscape import LandscapeSpec
from hexctl.types import N_LEGS

#: The five of the paper.
HEURISTICS = ("pso", "psosp", "dps", "debest", "derand")
BASELINE = "random"

#: Self-rotation of the landscapes: without, and as the optimizers search.
WITHOUT, WITH = "none", "rear"
ROTATIONS = (WITHOUT, WITH)

#: A seed shows leg and run as decimal digits, which limits their numbers.
MAX_RUNS = 999
MAX_BUDGET = 10_000
MAX_SEED = 10_000


@dataclass(frozen=True, kw_only=True)
class StudyPlan:
    """Settings of one study; the defaults are the paper's.

    Attributes:
        robot: model of the robot.
        world: the simulated world.
        legs: the failed legs, ascending.
        optimizers: names as in `hexctl.adapt.shipped`.
        runs: seeded runs of each optimizer on each leg.
        budget: evaluations of a run.
        duration_s: length of each walk.
        seed: of everything.
    """

    robot: Robot
    world: World = field(default_factory=World)
    legs: tuple[int, ...] = tuple(range(1, N_LEGS + 1))
    optimizers: tuple[str, ...] = (*HEURISTICS, BASELINE)
    runs: int = 30
    budget: int = 120
    duration_s: float = 30.0
    seed: int = 0

    def __post_init__(self) -> None:
        check_robot(self.robot)
        check_type(self.world, World, "plan.world", "a World, as load_world('slippery') gives")
        for name in ("legs", "optimizers"):
            check_type(getattr(self, name), (tuple, list), f"plan.{name}", "a tuple")
        for name, kind in (("runs", int), ("budget", int), ("seed", int), ("duration_s", float)):
            check_type(getattr(self, name), kind, f"plan.{name}")

    def specs(self) -> list[LandscapeSpec]:
        """Specs of all landscapes, leg by leg."""
        return [
            LandscapeSpec(
                robot=self.robot,
                world=self.world,
                leg=leg,
                self_rotation=rotation,
                duration_s=self.duration_s,
                seed=self.seed,
            )
            for leg in self.legs
            for rotation in ROTATIONS
        ]

    def seed_of(self, leg: int, run: int) -> int:
        """Seed of a run, counted from 0; `hexctl adapt --seed` repeats the run with it."""
        return self.seed * 10_000 + leg * 1_000 + run

    def check(self) -> None:
        """Raise InputError for anything that is not allowed, before anything runs."""
        _require(bool(self.legs), argument("legs"), "none", "one or more of 1..6")
        unknown = [leg for leg in self.legs if not 1 <= leg <= N_LEGS]
        _require(not unknown, argument("legs"), unknown, "1..6")
        _require(len(set(self.legs)) == len(self.legs), argument("legs"), list(self.legs), "each leg once")
        _require(1 <= self.runs <= MAX_RUNS, argument("runs"), self.runs, f"1..{MAX_RUNS}")
        _require(1 <= self.budget <= MAX_BUDGET, argument("budget"), self.budget, f"1..{MAX_BUDGET}")
        _require(0 <= self.seed <= MAX_SEED, argument("seed"), self.seed, f"0..{MAX_SEED}")
        _require(math.isfinite(self.duration_s), argument("duration_s"), self.duration_s, "a finite time")
        self._check_optimizers()
        check_walks(self.specs())

    def _check_optimizers(self) -> None:
        names = self.optimizers
        _require(bool(names), argument("optimizers"), "none", "one or more names")
        _require(len(set(names)) == len(names), argument("optimizers"), ",".join(names), "each name once")
        for name in names:
            make_optimizer(name, GaitSpace((self.legs[0],)), self.seed)


def check_robot(robot: object) -> None:
    """Raise WrongTypeError unless the robot of a plan is a `Robot`."""
    check_type(robot, Robot, "plan.robot", "a Robot, as load_robot('ant') gives")


def check_walks(specs: Iterable[LandscapeSpec]) -> None:
    """Raise InputError for a robot that cannot walk the gaits; those of a leg have the same joint ranges."""
    for spec in specs:
        try:
            check_plan(spec.robot, spec.trial(spec.codes[0]).plan)
        except (ReachError, LimitError) as error:
            raise InputError(f"{spec.robot.name}, {spec.title}: {error}") from error


def _require(holds: bool, what: str, got: object, allowed: str) -> None:
    if not holds:
        raise InputError(f"{what}: got {got}; allowed: {allowed}")
