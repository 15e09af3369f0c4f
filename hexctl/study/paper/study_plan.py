"""Settings of the paper's study: all gaits of each failed leg, and all optimizers on them."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.space import GaitSpace
from hexctl.backends.sim.draws import Distribution
from hexctl.backends.sim.world import World
from hexctl.control.trial_plan import DURATION_S, SelfRotation
from hexctl.errors import argument
from hexctl.options import Range
from hexctl.robot.failure import UNKNOWN
from hexctl.robot.failure_grammar import parse_kind
from hexctl.robot.model import Robot
from hexctl.study.landscape import N_CODES, LandscapeSpec
from hexctl.study.paper.leg_groups import experiments_of
from hexctl.study.plan import LandscapePlan, check_legs, check_setting, check_walks
from hexctl.study.study_options import ALL_LEGS, BUDGET, RUNS, STUDY_SEED

#: The five optimizers of the paper, and the baseline.
HEURISTICS = ("pso", "psosp", "dps", "debest", "derand")
BASELINE = "random"

#: Self-rotation of the landscapes without one.
WITHOUT: SelfRotation = "none"

#: Default self-rotation of the landscapes that the optimizers search.
WITH: SelfRotation = "rear"

#: A seed shows leg and run as decimal digits, which limits their numbers.
MAX_SEED = int(STUDY_SEED.high)


#: Factors on the world's own values that the paper leaves open. Joint offsets and a shifted trunk are not
#: among them, because they favour legs: legs of one experiment stay one.
FACTORS = {
    "friction": Distribution(low=1 / 1.3, high=1.3, scale="log"),
    "servo_stiffness": Distribution(low=1 / 1.3, high=1.3, scale="log"),
    "contact_time_s": Distribution(low=1 / 1.5, high=1.5, scale="log"),
}

#: Seed of the design: the same world always has the same neighbours.
SEED = 13

#: More worlds narrow the intervals too little for their computing time.
WORLDS = Range(low=1, high=100, whole=True)


@dataclass(frozen=True, kw_only=True)
class StudyPlan(LandscapePlan):
    """Settings of one study; the defaults are the paper's.

    Attributes:
        optimizers: names as in `hexctl.adapt.optimizers.shipped`.
        runs: seeded runs of each optimizer on each leg.
        failure: of each leg, as `parse_kind` reads it, such as `limp` or `weak:0.5`.
        self_rotation: before the walks that the optimizers search.
        worlds: number of worlds in which claims are judged: `world` and others like it (`nearby_worlds`).
        by_symmetry: simulate one leg of each experiment (`experiments_of`) and map it to the others. In the
            worlds like `world` this is always done.
        without_gaits: number of gaits walked without self-rotation, drawn from all.
    """

    robot: Robot
    world: World = field(default_factory=World)
    legs: tuple[int, ...] = ALL_LEGS
    optimizers: tuple[str, ...] = (*HEURISTICS, BASELINE)
    runs: Annotated[int, RUNS] = 30
    budget: Annotated[int, BUDGET] = 120
    duration_s: Annotated[float, DURATION_S] = 30.0
    seed: Annotated[int, STUDY_SEED] = 0
    failure: str = "locked"
    self_rotation: SelfRotation = WITH
    worlds: Annotated[int, WORLDS] = 1
    by_symmetry: bool = False
    without_gaits: Annotated[int, Range(low=1, high=N_CODES, whole=True)] = N_CODES

    @property
    def rotations(self) -> tuple[SelfRotation, ...]:
        """Self-rotations of the landscapes."""
        return tuple(dict.fromkeys((WITHOUT, self.self_rotation)))

    def specs(self) -> list[LandscapeSpec]:
        """Return the specs of all landscapes, world by world and leg by leg."""
        return [spec for specs in self.specs_by_world() for spec in specs]

    def specs_by_world(self) -> list[list[LandscapeSpec]]:
        """Return the specs of the landscapes of each world, the plan's own world first."""
        worlds = nearby_worlds(self.world, self.worlds)
        return [self._specs_in(world, number) for number, world in enumerate(worlds)]

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
        """Simulated legs in a world: all, or the first one of each experiment."""
        if number == 0 and not self.by_symmetry:
            return self.legs
        return tuple(group[0] for group in self.experiments(world, rotation))

    def experiments(self, world: World, rotation: str) -> tuple[tuple[int, ...], ...]:
        """Return the legs in groups of one experiment each, in a world and with a self-rotation."""
        return experiments_of(self.robot, world, rotation, self.legs, self.failure)

    def _codes(self, rotation: str) -> tuple[int, ...]:
        """Gaits of a landscape; the optimizers search all of them."""
        if rotation == self.self_rotation or self.without_gaits >= N_CODES:
            return tuple(range(1, N_CODES + 1))
        drawn = np.random.default_rng(0).permutation(N_CODES)[: self.without_gaits] + 1
        return tuple(sorted(drawn.tolist()))

    def seed_of(self, leg: int, run: int, world: int = 0) -> int:
        """Return the seed of a run, counted from 0; `hexctl adapt --seed` repeats the run with it.

        Runs in other worlds, counted from 1, have other seeds.
        """
        return world * (MAX_SEED + 1) * 10_000 + self.seed * 10_000 + leg * 1_000 + run

    def check(self) -> None:
        """Raise InputError for invalid settings, before anything runs."""
        super().check()
        check_legs(self.legs)
        parse_kind(self.legs[0], self.failure)
        allowed = "one that is the same in every leg; the transfer benchmark takes unknown"
        check_setting("failure", self.failure, self.failure != UNKNOWN, allowed)
        for name in self.optimizers:
            make_optimizer(name, GaitSpace((self.legs[0],)), self.seed, part="optimizers")
        check_walks(self.specs())


def nearby_worlds(world: World, count: int) -> list[World]:
    """The world itself and `count` - 1 others like it.

    The others differ in friction, servo stiffness and contact time, by `FACTORS`, in a quasi-random
    design; any first part of it covers the ranges. Raises InputError for a count outside 1..`WORLDS`.
    """
    WORLDS.check(argument("worlds"), count)
    if count == 1:
        return [world]
    shares = _design(count - 1)
    return [world, *(_varied(world, row) for row in shares)]


def _design(count: int) -> list[list[float]]:
    """Points of a Sobol design in the unit cube, one row per world."""
    from scipy.stats.qmc import Sobol

    sequence = Sobol(len(FACTORS), scramble=True, rng=np.random.default_rng(SEED))
    # One at a time keeps SciPy from warning about unbalanced draws.
    return [sequence.random(1)[0].tolist() for _ in range(count)]


def _varied(world: World, shares: Sequence[float]) -> World:
    values = world.model_dump()
    for (name, factor), share in zip(FACTORS.items(), shares, strict=True):
        values[name] = float(values[name] * factor.at(np.array(share)))
    return World.model_validate(values)
