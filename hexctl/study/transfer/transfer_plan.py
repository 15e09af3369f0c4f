"""Settings of a transfer benchmark: unseen worlds, legs, optimizers, runs and trials."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from hexctl.adapt.optimizers.shipped import BAYES
from hexctl.adapt.prior.prior import Prior, PriorKey, load_prior
from hexctl.adapt.prior.prior_files import find_prior
from hexctl.adapt.prior.samples import covering, covers
from hexctl.backends.sim.world import DomainRandomization
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import InputError, argument, check_type
from hexctl.gait.gait import make_gait
from hexctl.robot.failure_grammar import KINDS, parse_kind
from hexctl.robot.model import Robot
from hexctl.study.landscapes.landscape import LandscapeSpec
from hexctl.study.prior_building import WHOLE_S, in_whole_steps
from hexctl.study.study_options import WORLDS
from hexctl.study.study_plan import BASELINE, HEURISTICS, StudyPlan, check_robot
from hexctl.types import N_LEGS

#: The family of unseen worlds.
UNSEEN = "transfer"

#: The first worlds of the family were looked at while `bayes` was made; the benchmark begins after them.
FIRST_WORLD = 65

#: `bayes` with early stopping.
EARLY = "bayes-early"

PRIORED = (BAYES, EARLY)

MAX_WORLDS = int(WORLDS.high)


@dataclass(frozen=True, kw_only=True)
class TransferPlan:
    """Settings of one benchmark.

    Attributes:
        robot: model of the robot.
        family: the unseen worlds, never those of a prior.
        prior: prior of `bayes`.
        worlds: number of worlds of the family.
        legs: the failed legs, ascending.
        optimizers: names as in `hexctl.adapt.optimizers.shipped`, `bayes` and `bayes-early`.
        runs: seeded runs of each optimizer in each world and leg; `bayes` has no seed and one run.
        budget: trials of a run.
        duration_s: length of each walk.
        target_m: deviation that `bayes` aims at.
        seed: of the searches.
        failure: of each leg, in the words of `parse_kind`; with `unknown` each world draws what breaks,
            and the searches are not told.
        one_leg: one leg fails in each world, the next one in the next world, instead of all in every world.
    """

    robot: Robot
    family: DomainRandomization
    prior: Prior
    worlds: int = 30
    legs: tuple[int, ...] = tuple(range(1, N_LEGS + 1))
    optimizers: tuple[str, ...] = (*PRIORED, *HEURISTICS, BASELINE)
    runs: int = 5
    budget: int = 60
    duration_s: float = 30.0
    target_m: float = 0.025
    seed: int = 0
    failure: str = "locked"
    one_leg: bool = False

    def __post_init__(self) -> None:
        check_robot(self.robot)
        allowed = f"a DomainRandomization, as load_randomization('{UNSEEN}') gives"
        check_type(self.family, DomainRandomization, "plan.family", allowed)
        check_type(self.prior, Prior, "plan.prior", "a Prior, as load_prior(path) gives")
        check_type(self.failure, str, "plan.failure", KINDS)
        check_type(self.one_leg, bool, "plan.one_leg")

    def specs(self) -> list[LandscapeSpec]:
        """Specs of the landscapes, world by world; a world's number is the seed of what is drawn in it."""
        numbers = range(FIRST_WORLD, FIRST_WORLD + self.worlds)
        worlds = self.family.members(FIRST_WORLD, self.worlds)
        return [
            LandscapeSpec(
                robot=self.robot,
                world=world,
                leg=leg,
                self_rotation="rear",
                duration_s=self.duration_s,
                failure=self.failure,
                seed=number,
                place=f"world {number} ({self.family.kind(number).name})",
            )
            for number, world in zip(numbers, worlds, strict=True)
            for leg in self._legs_in(number)
        ]

    def _legs_in(self, number: int) -> tuple[int, ...]:
        """Legs that fail in a world."""
        return (self.legs[number % len(self.legs)],) if self.one_leg else self.legs

    def kind_of(self, spec: LandscapeSpec) -> str:
        """Kind of a landscape's world."""
        return self.family.kind(spec.seed).name

    def runs_of(self, optimizer: str) -> int:
        """Number of runs of an optimizer; without a seed all runs are the same, and one is enough."""
        return 1 if optimizer in PRIORED else self.runs

    def seed_of(self, spec: LandscapeSpec, run: int) -> int:
        """Seed of a run."""
        return ((self.seed * MAX_WORLDS + spec.seed) * N_LEGS + spec.leg) * 1_000 + run

    def check(self) -> None:
        """Raise InputError for anything that is not allowed, before anything runs."""
        WORLDS.check(argument("worlds"), self.worlds)
        parse_kind(1, self.failure)
        others = tuple(name for name in self.optimizers if name not in PRIORED) or (BASELINE,)
        StudyPlan(
            robot=self.robot,
            legs=self.legs,
            optimizers=others,
            runs=self.runs,
            budget=self.budget,
            duration_s=self.duration_s,
            seed=self.seed,
        ).check()
        if not self.optimizers or len(set(self.optimizers)) != len(self.optimizers):
            given = ",".join(self.optimizers) or "none"
            raise InputError(f"{argument('optimizers')}: got {given}; allowed: one or more names, each once")
        if self.family.model_dump(mode="json") == self.prior.origin.get("family"):
            raise InputError("transfer: the prior was built from these worlds; allowed: a family of others")
        missing = [leg for leg in self.legs if not covers(self.robot, "rear", self.prior.legs, leg)]
        if missing:
            raise InputError(
                f"prior: has nothing on legs {missing}; allowed: {argument('legs')} {list(self.prior.legs)}"
            )
        if not in_whole_steps(self.duration_s):
            raise InputError(
                f"{argument('duration_s')}: got {self.duration_s:g}; allowed: multiples of {WHOLE_S:g} s"
            )
        differences = self.prior.key.differences(PriorKey.of(self.robot, self.trial_plan()))
        if differences:
            raise InputError(f"prior: is for {', '.join(differences)}; allowed: a prior for these trials")

    def trial_plan(self) -> TrialPlan:
        """Plan of a trial, with the gait of code 1."""
        return self.specs()[0].trial(1).plan


def find_transfer_prior(
    robot: Robot,
    legs: tuple[int, ...],
    duration_s: float,
    folders: Iterable[Path],
    *,
    failure: str = "locked",
) -> Prior:
    """First prior in some folders that covers the trials of a benchmark; InputError if there is none."""
    if not legs:
        raise InputError(f"{argument('legs')}: got none; allowed: one or more of 1..6")
    belief = parse_kind(legs[0], failure)
    plan = TrialPlan(gait=make_gait(robot, "demo"), duration_s=duration_s, belief=belief)
    found = find_prior(PriorKey.of(robot, plan), folders, covers=covering(robot, plan))
    if found.path is None:
        raise InputError(
            f"prior: there is none for these trials ({found.reason}); hexctl prior build makes one"
        )
    return load_prior(found.path)
