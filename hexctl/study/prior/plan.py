"""What a prior is built from: which robot, failure and trial, in which worlds."""

import math
from dataclasses import dataclass, replace

from hexctl.backends.sim.family import Spread, WorldFamily
from hexctl.control.plan import TrialPlan
from hexctl.errors import InputError
from hexctl.gait.named import make_gait
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.study.landscape import LandscapeSpec
from hexctl.study.plan import check_walks
from hexctl.types import N_LEGS

#: Each leg has worlds of its own, so that six legs see six times as many; a block is spread evenly by itself.
WORLDS_PER_LEG = 1024

#: How far self-rotations miss their goal, in degrees: seen in `transfer` worlds, +2 to -4.
MISS_DEG = Spread(low=-4.0, high=4.0, scale="normal")

#: A shorter walk is soft start for the most part.
MIN_DURATION_S = 6.0

#: Walks last multiples of this, so that ten checkpoints fall on points that are kept, five a second.
WHOLE_S = 2.0


@dataclass(frozen=True, kw_only=True)
class PriorPlan:
    """One prior.

    Attributes:
        robot: who walks.
        family: the worlds that are plausible.
        worlds: how many of them each leg walks in.
        legs: the failed legs, ascending.
        failure: the kind of failure.
        self_rotation: where the failed leg points during the walk.
        duration_s: how long each gait walks.
    """

    robot: Robot
    family: WorldFamily
    worlds: int = 16
    legs: tuple[int, ...] = tuple(range(1, N_LEGS + 1))
    failure: str = "locked"
    self_rotation: str = "rear"
    duration_s: float = 30.0

    def specs(self) -> list[LandscapeSpec]:
        """Return the landscapes to walk, world by world, so that a part of them already serves all legs.

        The robot is put down as its self-rotation would leave it, which misses its goal a little.
        """
        by_leg = [self._specs_of(leg) for leg in self.legs]
        return [specs[index] for index in range(self.worlds) for specs in by_leg]

    def _specs_of(self, leg: int) -> list[LandscapeSpec]:
        first = (leg - 1) * WORLDS_PER_LEG
        worlds = self.family.members(first, self.worlds)
        misses_deg = self.family.spare(MISS_DEG, first, self.worlds).tolist()
        return [
            LandscapeSpec(
                robot=self.robot,
                world=world,
                leg=leg,
                self_rotation=self.self_rotation,
                duration_s=self.duration_s,
                failure=self.failure,
                # Floors with bumps are drawn with the seed, and each world has its own.
                seed=first + index
                if world.roughness_m or not isinstance(world.joint_offset_deg, tuple)
                else 0,
                placed=True,
                miss_rad=math.radians(miss_deg) if self.self_rotation != "none" else 0.0,
                place=f"world {index + 1}",
            )
            for index, (world, miss_deg) in enumerate(zip(worlds, misses_deg, strict=True))
        ]

    def trial_plan(self) -> TrialPlan:
        """Return a trial as a session walks it, self-rotation included; its gait is one of many."""
        failure = Failure(leg=self.legs[0], kind=self.failure)
        return TrialPlan(
            gait=make_gait(self.robot, "demo"),
            duration_s=self.duration_s,
            failure=failure,
            self_rotation=self.self_rotation,
        )

    def check(self) -> None:
        """Raise InputError for anything that is not allowed, before anything runs."""
        if not self.legs or not set(self.legs) <= set(range(1, N_LEGS + 1)):
            raise InputError(f"--legs: got {list(self.legs)}; allowed: one or more of 1..{N_LEGS}")
        if len(set(self.legs)) != len(self.legs):
            raise InputError(f"--legs: got {list(self.legs)}; allowed: each leg once")
        if not math.isfinite(self.duration_s):
            raise InputError(f"--duration: got {self.duration_s:g}; allowed: {MIN_DURATION_S:g} s or more")
        if self.duration_s < MIN_DURATION_S or not in_whole_steps(self.duration_s):
            raise InputError(
                f"--duration: got {self.duration_s:g}; allowed: {MIN_DURATION_S:g} s or more, in steps of "
                f"{WHOLE_S:g} s"
            )
        if not 2 <= self.worlds <= WORLDS_PER_LEG:
            raise InputError(f"--worlds: got {self.worlds}; allowed: 2..{WORLDS_PER_LEG}")
        # The gaits do not depend on the world, so one of them will do.
        check_walks(replace(self, worlds=1).specs())


def in_whole_steps(duration_s: float) -> bool:
    """Return whether a finite duration is a multiple of `WHOLE_S`."""
    return abs(duration_s / WHOLE_S - round(duration_s / WHOLE_S)) < 1e-9
