"""The optimizer of a session, as its spec says."""

from pathlib import Path

import numpy as np

from hexctl.adapt.bayes import REAL_NOISE_M, SIMULATED_NOISE_M, Bayes
from hexctl.adapt.deduplication import Deduplication
from hexctl.adapt.optimizer import Optimizer
from hexctl.adapt.prior.find import Serves, check_prior
from hexctl.adapt.prior.prior import PriorKey, load_prior
from hexctl.adapt.prior.samples import samples_of, serves
from hexctl.adapt.registry import make_optimizer
from hexctl.adapt.session import SessionSpec
from hexctl.adapt.space import GaitSpace
from hexctl.control.plan import TrialPlan
from hexctl.control.result import progress_floor_m
from hexctl.errors import InputError
from hexctl.robot.model import Robot

#: The paper's finer deviation: what `bayes` looks for unless told otherwise.
DEFAULT_TARGET_M = 0.025


def make_search(spec: SessionSpec, robot: Robot, plan: TrialPlan) -> Optimizer:
    """Return the optimizer of a session, fresh.

    Raises InputError for a prior that is none, is for something else or is not the session's any more.
    """
    space = GaitSpace((spec.failed_leg,))
    if spec.prior is None:
        inner = make_optimizer(spec.optimizer, space, spec.seed)
        return Deduplication(inner, spec.seed, paper_count=spec.count_repeats)
    path = Path(spec.prior)
    check_prior(path, PriorKey.of(robot, plan), serves=serving(robot, plan))
    prior = load_prior(path)
    if spec.prior_digest and prior.digest() != spec.prior_digest:
        raise InputError(
            f"prior {path}: is not the one the session began with; allowed: the same file, or a new session"
        )
    search = Bayes(
        space,
        spec.seed,
        samples=samples_of(prior, robot, spec.failed_leg),
        target_m=DEFAULT_TARGET_M if spec.target_m is None else spec.target_m,
        duration_s=spec.duration_s,
        floor_m=progress_floor_m(robot, plan, plan.duration_s),
        noise_m=SIMULATED_NOISE_M if spec.backend == "sim" else REAL_NOISE_M,
    )
    if spec.sag_rad is not None:
        search.observe_stance(np.array(spec.sag_rad, dtype=float))  # None becomes NaN
    return search


def knows_stances(spec: SessionSpec) -> bool:
    """Return whether the session's prior can tell anything from how the robot stands.

    Raises InputError for a prior that is none.
    """
    return spec.prior is not None and load_prior(Path(spec.prior)).sag_rad is not None


def serving(robot: Robot, plan: TrialPlan) -> Serves:
    """Return what says whether a prior of some legs serves the trials of a session."""
    (leg,) = plan.failed_legs
    return lambda legs: serves(robot, plan.self_rotation, legs, leg)
