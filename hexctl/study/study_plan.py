"""Settings of a study: legs, optimizers, runs and evaluations."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.space import GaitSpace
from hexctl.backends.sim.world import World
from hexctl.control.walks.turning import check_plan
from hexctl.errors import InputError, LimitError, ReachError, argument, check_type
from hexctl.robot.failure import UNKNOWN
from hexctl.robot.failure_grammar import KINDS, parse_kind
from hexctl.robot.model import Robot
from hexctl.study.landscapes.landscape import N_CODES, LandscapeSpec
from hexctl.study.study_options import BUDGET, RUNS
from hexctl.study.verdicts.experiments import experiments_of
from hexctl.study.verdicts.worlds import MAX_WORLDS, nearby_worlds
from hexctl.types import N_LEGS

#: The five of the paper.
HEURISTICS = ("pso", "psosp", "dps", "debest", "derand")
BASELINE = "random"

#: Self-rotation of the landscapes: without, and as the optimizers search unless told otherwise.
WITHOUT, WITH = "none", "rear"
ROTATIONS = (WITHOUT, WITH)

#: Self-rotations in which the optimizers may search.
SELF_ROTATIONS = ("rear", "front", "none")

#: A seed shows leg and run as decimal digits, which limits their numbers.
MAX_SEED = 10_000


@dataclass(frozen=True, kw_only=True)
class StudyPlan:
    """Settings of one study; the defaults are the paper's.

    Attributes:
        robot: model of the robot.
        world: the simulated world.
        legs: the failed legs, ascending.
        optimizers: names as in `hexctl.adapt.optimizers.shipped`.
        runs: seeded runs of each optimizer on each leg.
        budget: evaluations of a run.
        duration_s: length of each walk.
        seed: of everything.
        failure: of each leg, in the words of `parse_kind`, such as `limp` or `weak:0.5`.
        self_rotation: before the walks that the optimizers search: `rear`, `front` or `none`.
        worlds: in how many worlds claims are judged: `world` and others like it (`nearby_worlds`).
        by_symmetry: simulate one leg of each experiment (`experiments_of`), and take the others from it; in
            the worlds like `world` this is always done.
        without_gaits: number of gaits that are walked without self-rotation, drawn from all.
    """

    robot: Robot
    world: World = field(default_factory=World)
    legs: tuple[int, ...] = tuple(range(1, N_LEGS + 1))
    optimizers: tuple[str, ...] = (*HEURISTICS, BASELINE)
    runs: int = 30
    budget: int = 120
    duration_s: float = 30.0
    seed: int = 0
    failure: str = "locked"
    self_rotation: str = WITH
    worlds: int = 1
    by_symmetry: bool = False
    without_gaits: int = N_CODES

    def __post_init__(self) -> None:
        check_robot(self.robot)
        check_type(self.world, World, "plan.world", "a World, as load_world('slippery') gives")
        for name in ("legs", "optimizers"):
            check_type(getattr(self, name), (tuple, list), f"plan.{name}", "a tuple")
        for name in ("runs", "budget", "seed", "worlds", "without_gaits"):
            check_type(getattr(self, name), int, f"plan.{name}")
        check_type(self.duration_s, float, "plan.duration_s")
        check_type(self.failure, str, "plan.failure", KINDS)
        check_type(self.self_rotation, str, "plan.self_rotation", ", ".join(SELF_ROTATIONS))

    @property
    def rotations(self) -> tuple[str, ...]:
        """Self-rotations of the landscapes."""
        return tuple(dict.fromkeys((WITHOUT, self.self_rotation)))

    def specs(self) -> list[LandscapeSpec]:
        """Specs of all landscapes, world by world and leg by leg."""
        return [spec for specs in self.specs_by_world() for spec in specs]

    def specs_by_world(self) -> list[list[LandscapeSpec]]:
        """Specs of the landscapes of each world, the plan's own world first."""
        worlds = nearby_worlds(self.world, self.worlds)
        return [self._specs_in(world, number) for number, world in enumerate(worlds)]

    def searched_specs(self) -> list[LandscapeSpec]:
        """Specs of the landscapes of the plan's own world that the optimizers search."""
        return [spec for spec in self.specs_by_world()[0] if spec.self_rotation == self.self_rotation]

    def _specs_in(self, world: World, number: int) -> list[LandscapeSpec]:
        walked = {rotation: self._legs_walked(world, number, rotation) for rotation in self.rotations}
        return [
            LandscapeSpec(
                robot=self.robot,
                world=world,
                leg=leg,
                self_rotation=rotation,
                duration_s=self.duration_s,
                failure=self.failure,
                seed=self.seed,
                codes=self._codes(rotation),
                place=f"world {number + 1} of {self.worlds}" if number else "",
            )
            for leg in self.legs
            for rotation in self.rotations
            if leg in walked[rotation]
        ]

    def _legs_walked(self, world: World, number: int, rotation: str) -> tuple[int, ...]:
        """Legs that are simulated in a world: all, or the first one of each experiment."""
        if number == 0 and not self.by_symmetry:
            return self.legs
        return tuple(group[0] for group in self.experiments(world, rotation))

    def experiments(self, world: World, rotation: str) -> tuple[tuple[int, ...], ...]:
        """Legs in groups that are one experiment each, in a world and with a self-rotation."""
        return experiments_of(self.robot, world, rotation, self.legs, self.failure)

    def _codes(self, rotation: str) -> tuple[int, ...]:
        """Gaits of a landscape; the optimizers search all of them."""
        if rotation == self.self_rotation or self.without_gaits >= N_CODES:
            return tuple(range(1, N_CODES + 1))
        drawn = np.random.default_rng(0).permutation(N_CODES)[: self.without_gaits] + 1
        return tuple(sorted(drawn.tolist()))

    def seed_of(self, leg: int, run: int, world: int = 0) -> int:
        """Seed of a run, counted from 0; `hexctl adapt --seed` repeats the run with it.

        Runs in other worlds, counted from 1, have seeds of their own.
        """
        return world * (MAX_SEED + 1) * 10_000 + self.seed * 10_000 + leg * 1_000 + run

    def check(self) -> None:
        """Raise InputError for anything that is not allowed, before anything runs."""
        _require(bool(self.legs), argument("legs"), "none", "one or more of 1..6")
        unknown = [leg for leg in self.legs if not 1 <= leg <= N_LEGS]
        _require(not unknown, argument("legs"), unknown, "1..6")
        _require(len(set(self.legs)) == len(self.legs), argument("legs"), list(self.legs), "each leg once")
        RUNS.check(argument("runs"), self.runs)
        BUDGET.check(argument("budget"), self.budget)
        _require(0 <= self.seed <= MAX_SEED, argument("seed"), self.seed, f"0..{MAX_SEED}")
        turn = self.self_rotation
        _require(turn in SELF_ROTATIONS, argument("self_rotation"), turn, ", ".join(SELF_ROTATIONS))
        _require(1 <= self.worlds <= MAX_WORLDS, argument("worlds"), self.worlds, f"1..{MAX_WORLDS}")
        gaits = self.without_gaits
        _require(1 <= gaits <= N_CODES, argument("without_gaits"), gaits, f"1..{N_CODES}")
        parse_kind(self.legs[0], self.failure)
        _require(
            self.failure != UNKNOWN,
            argument("failure"),
            self.failure,
            "one that is the same in every leg; the transfer benchmark takes unknown",
        )
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


def check_setting(name: str, got: object, holds: bool, allowed: str) -> None:
    """Raise InputError for a setting, by its name, unless something holds."""
    if not holds:
        raise InputError(f"{argument(name)}: got {got}; allowed: {allowed}")


def check_each(name: str, given: tuple[object, ...] | list[str], known: tuple[object, ...] = ()) -> None:
    """Raise InputError unless there are values, each once, and all of them known."""
    among = f" of {', '.join(map(str, known))}" if known else ""
    fine = bool(given) and len(set(given)) == len(given) and (not known or set(given) <= set(known))
    check_setting(name, ",".join(map(str, given)) or "none", fine, f"one or more{among}, each once")
