"""Paths whose distance and deviations are known, scored."""

import math
from typing import Any

import numpy as np

from hexctl import TrialPlan, TrialResult
from hexctl.control.assessment.score import score
from hexctl.control.trace import TrialFrame
from hexctl.types import FloatArray
from tests.robots import shipped
from tests.trials import gait_of

UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


def _turned(yaws: FloatArray) -> FloatArray:
    zeros = np.zeros_like(yaws)
    return np.stack([np.cos(yaws / 2), zeros, zeros, np.sin(yaws / 2)], axis=-1)


def scored(
    path: FloatArray, *, heading: float = 0.0, yaws: FloatArray | None = None, status: str = "ok", **plan: Any
) -> TrialResult:
    """Score a path given in the trial frame, (T, 2), of a walk somewhere in the world."""
    origin = np.array([3.0, -2.0, 0.12])
    cos, sin = math.cos(heading), math.sin(heading)
    turned = path @ np.array([[cos, sin], [-sin, cos]])
    world = np.column_stack([turned + origin[:2], np.full(len(path), 0.1) + plan.pop("heights", 0.0)])
    quaternions = np.tile(UPRIGHT, (len(path), 1)) if yaws is None else _turned(yaws)
    duration_s, turned_rad = plan.pop("duration_s", 10.0), plan.pop("turned_rad", 0.0)
    hold, energy_j = plan.pop("hold", "none"), plan.pop("energy_j", None)
    return score(
        shipped(),
        TrialPlan(gait=gait_of(shipped()), **plan),
        status=status,
        duration_s=duration_s,
        turned_rad=turned_rad,
        clipped_ticks=3,
        hold=hold,
        energy_j=energy_j,
        frame=TrialFrame(origin, heading, 0.0 if yaws is None else float(yaws[0])),
        positions_world=world,
        quaternions_world=quaternions,
    )


def along(distance: float, off: FloatArray) -> FloatArray:
    return np.column_stack([np.linspace(0, distance, len(off)), off])
