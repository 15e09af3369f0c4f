"""The simulation's own uncertainty: how far a walk ends elsewhere when it is computed otherwise."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.backends.base import as_robot
from hexctl.backends.sim.world import World, as_world
from hexctl.control.batch import SimTrial, run_sim_trials
from hexctl.control.plan import TrialPlan
from hexctl.errors import InputError
from hexctl.gait.gait import make_gait
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.types import FloatArray

#: A looser tolerance of the solver: MuJoCo's own default.
LOOSE_TOLERANCE = 1e-8

#: By what the contact time is multiplied and divided: floor and feet a third softer or harder.
CONTACT_FACTOR = 4 / 3

#: Walks of these outcomes have no end.
ENDLESS = ("fell", "diverged")

#: The smallest time step of a world.
LEAST_STEP_S = 0.0005

#: Walks by which a robot's uncertainty is measured: ten gaits, with two failed legs that trail.
LEGS = (2, 5)
CODES = (5, 16, 29, 41, 54, 66, 79, 92, 103, 116)


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulationUncertainty:
    """Root mean square change of where walks end across their line, in m.

    Attributes:
        step_m: with the time step halved.
        solver_m: with the solver's tolerance at MuJoCo's default.
        contact_m: with contacts that give way by `CONTACT_FACTOR` slower and faster. How soft floor and feet
            are is an assumption about the world, not an error of the computation: it is not in `numerical_m`.
        walks: number of walks.
        duration_s: how long each of them walked.
    """

    step_m: float
    solver_m: float
    contact_m: float
    walks: int
    duration_s: float

    @property
    def numerical_m(self) -> float:
        """Standard uncertainty of the computation: step and solver together."""
        return float(np.hypot(self.step_m, self.solver_m))

    def to_dict(self) -> dict[str, Any]:
        """JSON values, lengths rounded to 0.1 mm."""
        lengths = {name: round(getattr(self, name), 4) for name in ("step_m", "solver_m", "contact_m")}
        return {
            **lengths,
            "numerical_m": round(self.numerical_m, 4),
            "walks": self.walks,
            "duration_s": self.duration_s,
        }


def uncertainty_of_walks(trials: Sequence[SimTrial]) -> SimulationUncertainty:
    """Uncertainty of walks of one duration, by walking each of them five times.

    Walks that have no end, because the robot fell, are left out. Raises InputError where no walk is left, or
    for a time step that cannot be halved.
    """
    (duration_s,) = {trial.plan.duration_s for trial in trials}
    half_s = trials[0].world.time_step_s / 2
    if half_s < LEAST_STEP_S:
        least_s = 2 * LEAST_STEP_S
        raise InputError(f"time_step_s: got {2 * half_s:g}; allowed: {least_s:g} or more, to halve it")
    contact_s = trials[0].world.contact_time_s
    plain = _ends_m(trials)
    step, solver, softer, harder = (
        _ends_m([replace(trial, world=trial.world.model_copy(update=changed)) for trial in trials]) - plain
        for changed in (
            {"time_step_s": half_s},
            {"solver_tolerance": LOOSE_TOLERANCE},
            {"contact_time_s": CONTACT_FACTOR * contact_s},
            {"contact_time_s": contact_s / CONTACT_FACTOR},
        )
    )
    known = np.isfinite(step + solver + softer + harder)
    if not known.any():
        raise InputError("walks: got none that walks to its end; allowed: at least one that does")
    return SimulationUncertainty(
        step_m=_rms(step[known]),
        solver_m=_rms(solver[known]),
        contact_m=_rms(np.concatenate([softer[known], harder[known]])),
        walks=int(known.sum()),
        duration_s=duration_s,
    )


def simulation_uncertainty(
    robot: Robot | str | Path, world: World | str | Path | None = None, *, duration_s: float = 30.0
) -> SimulationUncertainty:
    """Uncertainty of a robot's walks in a world, measured over ten gaits and two failed legs.

    Args:
        robot: the robot, or the name or path of its file.
        world: where, or its name or path; flat unless given.
        duration_s: how long each walk takes.

    Raises InputError as `uncertainty_of_walks` does, ReachError or LimitError for a robot that cannot walk.
    """
    model, place = as_robot(robot), as_world(world)
    trials = [_placed(model, place, leg, code, duration_s) for leg in LEGS for code in CODES]
    return uncertainty_of_walks(trials)


def _placed(robot: Robot, world: World, leg: int, code: int, duration_s: float) -> SimTrial:
    """A walk with a locked leg that trails, put down turned instead of turning first."""
    failure = Failure(leg=leg)
    gait = make_gait(robot, str(code), failed_legs=(leg,))
    plan = TrialPlan(gait=gait, belief=failure, duration_s=duration_s)
    return SimTrial(robot=robot, plan=plan, failure=failure, world=world).put_down_turned()


def _ends_m(trials: Sequence[SimTrial]) -> FloatArray:
    """Signed deviation at the end of each walk; NaN for one that has no end."""
    ended = [result.deviation if result.status not in ENDLESS else None for result in run_sim_trials(trials)]
    return np.array([np.nan if deviation is None else deviation.signed for deviation in ended])


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))
