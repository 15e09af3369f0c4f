"""The optimizer of a session, by its spec and prior."""

from dataclasses import replace

import numpy as np

from hexctl.adapt.optimizer import Optimizer, OptimizerClass
from hexctl.adapt.optimizers.bayes import Bayes
from hexctl.adapt.optimizers.deduplication import Deduplication
from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.optimizers.score_bayes import REAL_NOISE, SIMULATED_NOISE, WORTH, ScoreBayes
from hexctl.adapt.optimizers.shipped import STRIDES, TRIM
from hexctl.adapt.optimizers.strides import StrideSearch
from hexctl.adapt.optimizers.trim import TrimSearch
from hexctl.adapt.prior.prior import Prior, ScorePrior
from hexctl.adapt.prior.prior_choice import DEFAULT_TARGET_M, assumed_noise_m
from hexctl.adapt.prior.samples import drift_samples_of, samples_of, score_samples_of
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.space import GaitSpace
from hexctl.control.planning.static_stability import slots_by_stability
from hexctl.control.planning.top_speed import fast_gaits
from hexctl.control.scoring.score import ideal_distance_m, progress_floor_m
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.walks.turning import body_heading_rad
from hexctl.robot.model import Robot


def make_search(
    spec: SessionSpec,
    robot: Robot,
    plan: TrialPlan,
    prior: Prior | ScorePrior | None,
    optimizer: OptimizerClass | None = None,
) -> Optimizer:
    """Fresh optimizer of a session: `trim`, `strides`, `bayes` with a prior, else the one in its spec.

    `optimizer` is its class, if it cannot be imported by the name in the spec.
    """
    space = GaitSpace((spec.broken.leg,))
    heading_rad = body_heading_rad(robot, plan)
    if spec.optimizer in (TRIM, STRIDES):
        ranked = slots_by_stability(robot, heading_rad=heading_rad, failure=plan.failures)
    if spec.optimizer == STRIDES:
        gait = replace(plan.gait, slots=ranked[0])
        fast = fast_gaits(robot, gait, heading_rad=heading_rad, lost=plan.failed_legs, reorder=True)
        return StrideSearch(space, spec.seed, gaits=fast, ranked=ranked)
    if spec.optimizer == TRIM:
        known = drift_samples_of(prior, robot, spec.broken.leg) if isinstance(prior, Prior) else None
        return TrimSearch(
            space,
            spec.seed,
            codes=[space.code_of(slots) for slots in ranked],
            samples=known,
            target_m=DEFAULT_TARGET_M if spec.target_m is None else spec.target_m,
            duration_s=spec.duration_s,
            cycle_s=1 / plan.gait.pace_hz,
            floor_m=progress_floor_m(robot, plan, plan.duration_s),
            distance_m=ideal_distance_m(robot, plan, plan.duration_s),
            turns=spec.hold == "none",
        )
    if prior is None:
        inner = make_optimizer(optimizer or spec.optimizer, space, spec.seed)
        return Deduplication(inner, spec.seed, paper_count=spec.count_repeats)
    if isinstance(prior, ScorePrior):
        return ScoreBayes(
            space,
            spec.seed,
            samples=score_samples_of(prior, robot, spec.broken.leg, spec.objective),
            noise=SIMULATED_NOISE if spec.simulated else REAL_NOISE,
            worth=WORTH if spec.worth_m is None else spec.worth_m,
            budget=spec.budget - spec.confirm,
        )
    return Bayes(
        space,
        spec.seed,
        samples=samples_of(prior, robot, spec.broken.leg),
        target_m=DEFAULT_TARGET_M if spec.target_m is None else spec.target_m,
        duration_s=spec.duration_s,
        floor_m=progress_floor_m(robot, plan, plan.duration_s),
        noise_m=assumed_noise_m(spec),
        uncertainty_m=spec.uncertainty_m,
        worth_m=spec.worth_m or 0.0,
        budget=spec.budget - spec.confirm,
        sag_rad=None if spec.sag_rad is None else np.array(spec.sag_rad, dtype=float),  # None becomes NaN
    )
