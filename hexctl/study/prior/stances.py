"""How robots stand in simulated worlds, before they turn and walk."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hexctl.adapt.stance import stance_sag_rad
from hexctl.control.guard import Guard
from hexctl.errors import EStopError, SimulationDivergedError
from hexctl.study.landscape import LandscapeSpec
from hexctl.study.prior.plan import PriorPlan
from hexctl.types import N_JOINTS, FloatArray


def sag_of(spec: LandscapeSpec) -> FloatArray:
    """Return how far each joint stays behind where a landscape's trials begin, (18,); NaN where it falls."""
    trial = replace(spec, placed=False, miss_rad=0.0).trial(spec.codes[0])
    try:
        with Guard(trial.servos()) as servos:
            sag_rad = stance_sag_rad(servos, trial.plan)
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
