"""Priors built from landscapes in many plausible worlds."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from hexctl.adapt.prior.prior import (
    CHECKPOINTS,
    PRIOR_DURATION_S,
    WHOLE_S,
    Prior,
    PriorKey,
    ScorePrior,
    in_whole_steps,
    save_prior,
)
from hexctl.adapt.prior.prior_files import SUFFIX
from hexctl.adapt.stance import stance_deflection_rad
from hexctl.archive import ArchiveFileError
from hexctl.backends.sim.draws import Distribution
from hexctl.backends.sim.world import DomainRandomization, World
from hexctl.control.guard import Guard
from hexctl.control.planning.static_stability import usual_posture
from hexctl.control.trial_plan import SelfRotation, TrialPlan
from hexctl.errors import InputError, RobotFaultError, argument
from hexctl.files import write_trouble
from hexctl.robot.failure import UNKNOWN
from hexctl.robot.failure_grammar import parse_kind
from hexctl.robot.model import Robot
from hexctl.runs.run_spec import RunSpec
from hexctl.runs.walk_plan import plan_walk
from hexctl.study.landscape import Landscape, LandscapeSpec
from hexctl.study.plan import LandscapePlan, Plan, check_families, check_legs, check_setting, check_walks
from hexctl.study.priors.prior_options import (
    WORLDS,
    WORLDS_PER_LEG,
    PriorHold,
)
from hexctl.study.study_options import ALL_LEGS
from hexctl.study.versions import code_versions
from hexctl.study.walk_cache import ENDED
from hexctl.study.walking import Progress, Work
from hexctl.types import N_JOINTS, N_LEGS, FloatArray

#: By how much self-rotations miss their goal, in degrees. It is below 0.1 in simulation; the yaw that a
#: real robot estimates over a turn is good to about half a degree.
MISS_DEG = Distribution(low=-1.0, high=1.0, scale="normal")

#: Step of the physics if the family sets none: half the computing time of 2 ms. It moves ends of walks of
#: `ant` by 7 cm (RMS over 12 worlds of `randomised`); between worlds they differ by 81 cm.
TIME_STEP_S = 0.004


@dataclass(frozen=True, kw_only=True)
class PriorPlan(LandscapePlan):
    """Settings of one prior.

    Attributes:
        failure: as `parse_kind` reads it; with `unknown` each world draws what breaks.
        hold: what feedback keeps; unless `none`, the prior is one of scores.
    """

    robot: Robot
    family: DomainRandomization
    worlds: Annotated[int, WORLDS] = 16
    legs: tuple[int, ...] = ALL_LEGS
    failure: str = "locked"
    self_rotation: SelfRotation = "rear"
    duration_s: Annotated[float, PRIOR_DURATION_S] = 30.0
    hold: PriorHold = "none"

    def specs(self) -> list[LandscapeSpec]:
        """Landscapes to simulate, world by world; any first part of the list covers all legs.

        The robot is put down as its self-rotation would leave it, with a small random miss.
        """
        by_leg = [self._specs_of(leg) for leg in self.legs]
        return [specs[index] for index in range(self.worlds) for specs in by_leg]

    def _specs_of(self, leg: int) -> list[LandscapeSpec]:
        first = (leg - 1) * WORLDS_PER_LEG
        members = enumerate(self.family.members(first, self.worlds), first)
        worlds = [coarse_world(self.family, number, world) for number, world in members]
        misses_deg = self.family.spare(MISS_DEG, first, self.worlds).tolist()
        return [
            LandscapeSpec(
                robot=self.robot,
                world=world,
                leg=leg,
                self_rotation=self.self_rotation,
                duration_s=self.duration_s,
                failure=self.failure,
                seed=first + index if world.seeded or self.failure == UNKNOWN else 0,
                placed=True,
                miss_rad=math.radians(miss_deg) if self.self_rotation != "none" else 0.0,
                place=f"world {index + 1}",
                hold=self.hold,
            )
            for index, (world, miss_deg) in enumerate(zip(worlds, misses_deg, strict=True))
        ]

    def trial_plan(self) -> TrialPlan:
        """Trial of a session that the prior is for, self-rotation included, with the gait `demo`."""
        failure = parse_kind(self.legs[0], self.failure)
        walk = RunSpec(
            gait="demo",
            duration_s=self.duration_s,
            failure=failure,
            self_rotation=self.self_rotation,
            hold=self.hold,
        )
        return plan_walk(walk, self.robot)

    @property
    def key(self) -> PriorKey:
        """Key of the prior."""
        key = PriorKey.of(self.robot, self.trial_plan())
        return replace(key, posture=usual_posture(self.hold))

    def check(self) -> None:
        """Raise InputError for invalid settings, before anything runs."""
        super().check()
        check_families({"one in which legs fail": self.family}, "family")
        check_legs(self.legs)
        whole = in_whole_steps(self.duration_s)
        allowed = f"{PRIOR_DURATION_S.low:g} s or more, in steps of {WHOLE_S:g} s"
        check_setting("duration_s", f"{self.duration_s:g}", whole, allowed)
        # Whether the gaits can be walked does not depend on the world.
        check_walks(replace(self, worlds=2).specs()[: len(self.legs)])


def coarse_world(family: DomainRandomization, number: int, world: World) -> World:
    """Return a member of a family with the prior's time step, unless its kind sets one."""
    if "time_step_s" in family.kind(number).world:
        return world
    return world.model_copy(update={"time_step_s": TIME_STEP_S})


def begin_build(plan: Plan, path: Path, suffix: str, work: Work) -> None:
    """Check everything that can be checked before the simulation of walks for a file.

    Raises InputError for a plan or a path that cannot be used, CacheError and ArchiveFileError if the
    disk refuses a file.
    """
    plan.check()
    if path.suffix != suffix or path.is_dir():
        raise InputError(f"{argument('out')}: got {path}; allowed: a file whose name ends in {suffix}")
    work.cache.probe()
    if (trouble := write_trouble(path.parent)) is not None:
        raise ArchiveFileError(f"prior: {trouble}")


def build_prior(plan: PriorPlan, path: Path, work: Work | None = None) -> Prior | ScorePrior:
    """Simulate all gaits in the worlds of a plan, and write the prior to a file.

    It is a `Prior` of where open-loop walks end, or a `ScorePrior` under a hold.

    Args:
        path: of the file, ending in `.npz`; an existing file is replaced.

    Raises InputError for a plan, a path or an address that cannot be used, ArchiveFileError or CacheError
    if the disk refuses a file.
    """
    work = work or Work()
    begin_build(plan, path, SUFFIX, work)
    landscapes = work.evaluate(plan.specs())
    prior: Prior | ScorePrior
    if plan.hold == "none":
        work.progress.stage("stances", len(landscapes))
        prior = prior_of(plan, landscapes, deflections_of(plan, landscapes, work.progress))
    else:
        prior = score_prior_of(plan, landscapes)
    save_prior(prior, path)
    return prior


def prior_file_name(plan: PriorPlan, family: str) -> str:
    """Name of a prior's file by robot, failure and trial, and by legs and worlds if not the usual ones.

    `family` is the name of the plan's family of worlds, or the path of its file.
    """
    parts = [plan.robot.name, plan.failure.replace(":", "-"), plan.self_rotation, f"{plan.duration_s:g}s"]
    if plan.hold != "none":
        parts.append(plan.hold)
    if len(plan.legs) < N_LEGS:
        parts.append("leg" + "".join(str(leg) for leg in plan.legs))
    if family != "randomised":
        parts.append(Path(family).stem)
    return "-".join(parts) + SUFFIX


def deflection_of(spec: LandscapeSpec) -> FloatArray:
    """Static deflection of the joints in the stance of a landscape, rad, (18,); NaN when the robot falls."""
    trial = replace(spec, placed=False, miss_rad=0.0).trial(spec.codes[0])
    try:
        with Guard(trial.servos()) as servos:
            deflection_rad = stance_deflection_rad(servos, trial.plan)
    except RobotFaultError:
        deflection_rad = None
    return np.full(N_JOINTS, np.nan) if deflection_rad is None else deflection_rad


def _by_leg(plan: PriorPlan, landscapes: Sequence[Landscape], values: Callable[[Landscape], Any]) -> Any:
    """Values of each landscape, (legs, worlds, ...)."""
    return np.array([[values(one) for one in landscapes if one.spec.leg == leg] for leg in plan.legs])


def deflections_of(plan: PriorPlan, landscapes: Sequence[Landscape], progress: Progress) -> FloatArray:
    """Static deflections of the joints in all worlds of a prior, rad, (legs, worlds, 18)."""

    def one(landscape: Landscape) -> FloatArray:
        progress.step()
        return deflection_of(landscape.spec)

    return np.asarray(_by_leg(plan, landscapes, one))


def prior_of(
    plan: PriorPlan, landscapes: Sequence[Landscape], deflections_rad: FloatArray | None = None
) -> Prior:
    """Prior of a plan.

    Args:
        landscapes: complete and in the order of `plan.specs()`.
        deflections_rad: static deflections in the stance, (legs, worlds, 18), if known.
    """
    paths = _by_leg(plan, landscapes, checkpoints_of)
    yaws = _by_leg(plan, landscapes, lambda one: one.number("yaw_change_rad"))
    return Prior(
        key=plan.key,
        legs=plan.legs,
        origin=_origin(plan),
        signed_m=paths[..., 1],
        progress_m=paths[..., 0],
        yaw_rad=np.where(np.isfinite(paths[..., -1, 0]), yaws, np.nan),
        sag_rad=deflections_rad,
    )


def score_prior_of(plan: PriorPlan, landscapes: Sequence[Landscape]) -> ScorePrior:
    """Prior of a plan under a hold; landscapes are complete and in the order of `plan.specs()`."""
    return ScorePrior(
        key=plan.key,
        legs=plan.legs,
        origin=_origin(plan),
        log_scores=_by_leg(plan, landscapes, log_scores_of),
        valid=_by_leg(plan, landscapes, lambda one: one.valid),
    )


def log_scores_of(landscape: Landscape) -> FloatArray:
    """Logarithm of the scores of every gait, by the objectives of `SCORES`, (gaits, 4).

    NaN for a walk that ended early or did not get ahead.
    """
    distance_m = landscape.number("distance_m")
    walked = np.isin(landscape.status, ENDED) & (distance_m > 0)
    scores = np.stack(
        [
            landscape.spec.duration_s / np.where(walked, distance_m, np.nan),
            *(landscape.number(name) for name in ("cost_of_transport", "tilt_deg", "steadiness")),
        ],
        axis=-1,
    )
    return np.log(np.where(walked[:, np.newaxis] & (scores > 0), scores, np.nan))


def checkpoints_of(landscape: Landscape) -> FloatArray:
    """Progress and signed deviation of every gait at the checkpoints, in m, (gaits, CHECKPOINTS, 2)."""
    points = landscape.paths_m.shape[1]
    rows = np.rint(np.arange(1, CHECKPOINTS + 1) * points / CHECKPOINTS).astype(int) - 1
    return np.asarray(landscape.paths_m[:, rows], dtype=float)


def _origin(plan: PriorPlan) -> dict[str, Any]:
    return {
        "family": plan.family.model_dump(mode="json"),
        "worlds": plan.worlds,
        "time_step_s": TIME_STEP_S,
        "code": code_versions(),
    }
