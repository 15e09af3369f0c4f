"""What `hexctl prior build` does with its options: check, simulate what is missing, write."""

import json
from dataclasses import dataclass
from pathlib import Path

from hexctl.adapt.prior.find import SUFFIX
from hexctl.adapt.prior.prior import check_place, save_prior
from hexctl.backends.sim.world import load_randomization
from hexctl.cli.console import DONE, INTERRUPTED, print_result
from hexctl.cli.prioring import PRIORS, summary_of
from hexctl.cli.simulating import (
    check_jobs,
    open_cache,
    say_interrupted,
    terminated_as_interrupted,
    walked,
)
from hexctl.cli.studyprogress import StudyProgress
from hexctl.errors import InputError
from hexctl.robot.loader import load_robot
from hexctl.study.prior import PriorPlan, prior_of, sags_of
from hexctl.types import N_LEGS


@dataclass(frozen=True, slots=True, kw_only=True)
class PriorRequest:
    """The options of `hexctl prior build` as values."""

    robot: str
    worlds: int
    legs: tuple[int, ...]
    failure: str
    self_rotation: str
    duration_s: float
    family: str
    out: Path | None
    jobs: int | None
    dask: str | None
    as_json: bool


def execute(request: PriorRequest) -> int:
    """Build a prior and return the exit code."""
    check_jobs(request.jobs)
    plan = _checked_plan(request)
    path = request.out or PRIORS / _name_of(plan, request.family)
    if path.suffix != SUFFIX or path.is_dir():
        raise InputError(f"--out: got {path}; allowed: a file whose name ends in {SUFFIX}")
    cache = open_cache()
    check_place(path)
    try:
        with terminated_as_interrupted(), StudyProgress() as progress:
            landscapes = walked(plan.specs(), cache, progress, jobs=request.jobs, dask=request.dask)
            progress.stage("stances", len(landscapes))
            sags_rad = sags_of(plan, progress.step)
    except KeyboardInterrupt:
        say_interrupted(plan.specs(), cache)
        return INTERRUPTED
    prior = prior_of(plan, landscapes, sags_rad)
    save_prior(prior, path)
    outcome = {"prior": str(path), **summary_of(path)}
    print_result(
        json.dumps(outcome) if request.as_json else f"prior: {path} ({path.stat().st_size / 1e3:.0f} kB)"
    )
    return DONE


def _checked_plan(request: PriorRequest) -> PriorPlan:
    plan = PriorPlan(
        robot=load_robot(request.robot),
        family=load_randomization(request.family),
        worlds=request.worlds,
        legs=request.legs,
        failure=request.failure,
        self_rotation=request.self_rotation,
        duration_s=request.duration_s,
    )
    plan.check()
    return plan


def _name_of(plan: PriorPlan, family: str) -> str:
    """Return a name that tells priors apart, those of fewer legs or other worlds included."""
    parts = [plan.robot.name, plan.failure, plan.self_rotation, f"{plan.duration_s:g}s"]
    if len(plan.legs) < N_LEGS:
        parts.append("leg" + "".join(str(leg) for leg in plan.legs))
    if family != "randomised":
        parts.append(Path(family).stem)
    return "-".join(parts) + SUFFIX
