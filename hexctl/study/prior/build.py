"""From landscapes in many worlds to a prior."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from hexctl.adapt.prior.prior import CHECKPOINTS, Prior
from hexctl.adapt.prior.question import Question
from hexctl.study.landscape import Landscape
from hexctl.study.prior.plan import PriorPlan
from hexctl.study.versions import code_versions
from hexctl.types import FloatArray


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
        question=Question.of(plan.robot, plan.trial_plan()),
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
