"""Priors built from landscapes in many plausible worlds."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hexctl.adapt.prior.prior import CHECKPOINTS, Prior, PriorKey
from hexctl.adapt.stance import stance_deflection_rad
from hexctl.backends.sim.world import Distribution, DomainRandomization
from hexctl.control.guard import Guard
from hexctl.control.plan import TrialPlan
from hexctl.errors import EStopError, InputError, SimulationDivergedError
from hexctl.gait.gait import make_gait
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.study.landscape import Landscape, LandscapeSpec
from hexctl.study.plan import check_walks
from hexctl.study.versions import code_versions
from hexctl.types import N_JOINTS, N_LEGS, FloatArray

#: Each leg has worlds of its own, so that six legs see six times as many; a block is spread evenly by itself.
WORLDS_PER_LEG = 1024

#: How far self-rotations miss their goal, in degrees: seen in `transfer` worlds, +2 to -4.
MISS_DEG = Distribution(low=-4.0, high=4.0, scale="normal")

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
    family: DomainRandomization
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


def sag_of(spec: LandscapeSpec) -> FloatArray:
    """Return how far each joint stays behind where a landscape's trials begin, (18,); NaN where it falls."""
    trial = replace(spec, placed=False, miss_rad=0.0).trial(spec.codes[0])
    try:
        with Guard(trial.servos()) as servos:
            sag_rad = stance_deflection_rad(servos, trial.plan)
    except (EStopError, SimulationDivergedError):
        sag_rad = None
    return np.full(N_JOINTS, np.nan) if sag_rad is None else sag_rad


def sags_of(plan: PriorPlan, on_stance: Callable[[], None] = lambda: None) -> FloatArray:
    """Return how the joints stay behind in the worlds of a prior, (legs, worlds, 18); tell of each."""

    def sag_of_one(spec: LandscapeSpec) -> FloatArray:
        sag_rad = sag_of(spec)
        on_stance()
        return sag_rad

    specs = plan.specs()
    return np.array([[sag_of_one(spec) for spec in specs if spec.leg == leg] for leg in plan.legs])


def prior_of(plan: PriorPlan, landscapes: Sequence[Landscape], sags_rad: FloatArray | None = None) -> Prior:
    """Return the prior of a plan from its landscapes, complete and in the order of `plan.specs()`.

    Args:
        plan: what was asked.
        landscapes: what became of the gaits.
        sags_rad: how the joints stay behind in the stance, (legs, worlds, 18), if that is known.
    """
    by_leg = [[one for one in landscapes if one.spec.leg == leg] for leg in plan.legs]
    paths = np.array([[checkpoints_of(one) for one in some] for some in by_leg])
    yaws = np.array([[one.number("yaw_change_rad") for one in some] for some in by_leg])
    finished = np.isfinite(paths[..., -1, 0])
    return Prior(
        question=PriorKey.of(plan.robot, plan.trial_plan()),
        legs=plan.legs,
        origin=_origin(plan),
        signed_m=paths[..., 1],
        progress_m=paths[..., 0],
        yaw_rad=np.where(finished, yaws, np.nan),
        sag_rad=sags_rad,
    )


def checkpoints_of(landscape: Landscape) -> FloatArray:
    """Return progress and signed deviation of every gait at the checkpoints, (gaits, CHECKPOINTS, 2)."""
    points = landscape.paths_m.shape[1]
    rows = np.rint(np.arange(1, CHECKPOINTS + 1) * points / CHECKPOINTS).astype(int) - 1
    return np.asarray(landscape.paths_m[:, rows], dtype=float)


def _origin(plan: PriorPlan) -> dict[str, Any]:
    return {"family": plan.family.model_dump(mode="json"), "worlds": plan.worlds, "code": code_versions()}
