"""Settings of the transfer benchmark: held-out worlds, prior and searches."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.optimizers.shipped import BAYES
from hexctl.adapt.prior.prior import Prior, PriorKey, load_prior
from hexctl.adapt.prior.prior_files import find_prior
from hexctl.adapt.prior.samples import covers
from hexctl.adapt.space import GaitSpace
from hexctl.backends.sim.world import DomainRandomization
from hexctl.control.trial_plan import DURATION_S, TrialPlan
from hexctl.errors import InputError, argument
from hexctl.gait.gait import make_gait
from hexctl.robot.failure_grammar import parse_kind
from hexctl.robot.model import Robot
from hexctl.study.landscape import LandscapeSpec
from hexctl.study.paper.study_settings import BASELINE, HEURISTICS
from hexctl.study.plan import LandscapePlan, check_legs, check_setting, check_walks
from hexctl.study.priors.prior_building import WHOLE_S, in_whole_steps
from hexctl.study.study_options import ALL_LEGS, BUDGET, RUNS, STUDY_SEED, WORLDS
from hexctl.types import N_LEGS

#: The default family of worlds.
UNSEEN = "transfer"

#: Earlier worlds of the family were used to develop `bayes`.
FIRST_WORLD = 65

MAX_WORLDS = int(WORLDS.high)

#: `bayes` with early stopping.
EARLY = "bayes-early"

#: Optimizers that use a prior.
PRIORED = (BAYES, EARLY)


@dataclass(frozen=True, kw_only=True)
class TransferSettings(LandscapePlan):
    """Settings of one benchmark.

    Attributes:
        family: held-out worlds, never those of a prior.
        optimizers: names as in `hexctl.adapt.optimizers.shipped`, `bayes` and `bayes-early`.
        runs: seeded runs of each optimizer in each world and leg; `bayes` has no seed and one run.
        target_m: deviation that `bayes` aims at.
        failure: of each leg, as `parse_kind` reads it; with `unknown` each world draws what breaks, and the
            searches do not know it.
        one_leg: one leg fails in each world, the next one in the next world, instead of all in every world.
    """

    robot: Robot
    family: DomainRandomization
    prior: Prior
    worlds: Annotated[int, WORLDS] = 30
    legs: tuple[int, ...] = ALL_LEGS
    optimizers: tuple[str, ...] = (*PRIORED, *HEURISTICS, BASELINE)
    runs: Annotated[int, RUNS] = 5
    budget: Annotated[int, BUDGET] = 60
    duration_s: Annotated[float, DURATION_S] = 30.0
    target_m: float = 0.025
    seed: Annotated[int, STUDY_SEED] = 0
    failure: str = "locked"
    one_leg: bool = False

    def specs(self) -> list[LandscapeSpec]:
        """Specs of the landscapes, world by world; a world's number is the seed of its draws."""
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
            for number, world in enumerate(self.family.members(FIRST_WORLD, self.worlds), FIRST_WORLD)
            for leg in ((self.legs[number % len(self.legs)],) if self.one_leg else self.legs)
        ]

    def kind_of(self, spec: LandscapeSpec) -> str:
        """Kind of a landscape's world."""
        return self.family.kind(spec.seed).name

    def check(self) -> None:
        """Raise InputError for invalid settings, before anything runs."""
        super().check()
        check_legs(self.legs)
        parse_kind(1, self.failure)
        for name in self.optimizers:
            if name not in PRIORED:
                make_optimizer(name, GaitSpace((self.legs[0],)), self.seed)
        if self.family.model_dump(mode="json") == self.prior.origin.get("family"):
            raise InputError("transfer: the prior was built from these worlds; allowed: a family of others")
        missing = [leg for leg in self.legs if not covers(self.robot, "rear", self.prior.legs, leg)]
        if missing:
            raise InputError(
                f"prior: has nothing on legs {missing}; allowed: {argument('legs')} {list(self.prior.legs)}"
            )
        whole = in_whole_steps(self.duration_s)
        check_setting("duration_s", f"{self.duration_s:g}", whole, f"multiples of {WHOLE_S:g} s")
        differences = self.prior.key.differences(PriorKey.of(self.robot, self.specs()[0].trial(1).plan))
        if differences:
            raise InputError(f"prior: is for {', '.join(differences)}; allowed: a prior for these trials")
        check_walks(self.specs())

    def seed_of(self, spec: LandscapeSpec, run: int) -> int:
        """Seed of a run."""
        return ((self.seed * MAX_WORLDS + spec.seed) * N_LEGS + spec.leg) * 1_000 + run


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
    found = find_prior(robot, plan, folders)
    if found.path is None:
        raise InputError(
            f"prior: there is none for these trials ({found.reason}); hexctl prior build makes one"
        )
    return load_prior(found.path)
