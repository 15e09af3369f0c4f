"""Measured uncertainty of the simulation: how far walks end elsewhere with another computation."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from hexctl.backends.base import as_robot
from hexctl.backends.sim.world import World, as_world
from hexctl.control.assessment.uncertainty_store import (
    CONFIRM_STEP_S,
    MEASURED_FAILURE,
    SimulationUncertainty,
)
from hexctl.control.batch import SimTrial, run_sim_trials
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import InputError
from hexctl.gait.gait import make_gait
from hexctl.robot.failure_grammar import parse_kind
from hexctl.robot.model import Robot
from hexctl.types import FloatArray

#: A looser tolerance of the solver: MuJoCo's own default.
LOOSE_TOLERANCE = 1e-8

#: Factor of the contact time: floor and feet a third softer or harder.
CONTACT_FACTOR = 4 / 3

#: Outcomes of walks without an end.
ENDLESS = ("fell", "diverged")

#: The smallest time step of a world.
LEAST_STEP_S = 0.0005

#: Bootstrap samples of an interval, and the minimum number of walks for one.
RESAMPLES = 4000
LEAST_WALKS = 5

#: Walks of a measurement: ten gaits, with each of two failed legs that trail.
LEGS = (2, 5)
CODES = (5, 16, 29, 41, 54, 66, 79, 92, 103, 116)


def uncertainty_of_walks(trials: Sequence[SimTrial]) -> SimulationUncertainty:
    """Uncertainty of walks of one duration, each walked seven times; raises InputError for other walks."""
    duration_s = _duration_s(trials)
    least_s = min(trial.world.time_step_s for trial in trials)
    if least_s / 2 < LEAST_STEP_S:
        raise InputError(f"time_step_s: got {least_s:g}; allowed: {2 * LEAST_STEP_S:g} or more, to halve it")
    plain = _ends_m(trials)
    step, solver, softer, harder = (_changed_ends_m(trials, change) - plain for change in _CHANGES)
    known = np.isfinite(step + solver + softer + harder)
    if not known.any():
        raise InputError("walks: got none that walks to its end; allowed: at least one that does")
    low_m, high_m = _interval_m(step[known])
    return SimulationUncertainty(
        step_m=_rms(step[known]),
        solver_m=_rms(solver[known]),
        contact_m=_rms(np.concatenate([softer[known], harder[known]])),
        confirmed_m=_confirmed_m(trials),
        walks=int(known.sum()),
        duration_s=duration_s,
        low_m=low_m,
        high_m=high_m,
    )


def _interval_m(step: FloatArray) -> tuple[float, float] | tuple[None, None]:
    """95 % bootstrap interval of an RMS by percentiles (Efron and Tibshirani 1993, section 13.3)."""
    squares = step**2
    if len(squares) < LEAST_WALKS:
        return None, None
    drawn = np.random.default_rng(0).integers(len(squares), size=(RESAMPLES, len(squares)))
    low_m, high_m = np.sqrt(np.percentile(squares[drawn].mean(axis=1), (2.5, 97.5)))
    return float(low_m), float(high_m)


def _confirmed_m(trials: Sequence[SimTrial]) -> float | None:
    """RMS change of the ends if the time step of a confirmation is halved; None without ends."""
    at, finer = (_changed_ends_m(trials, change) for change in _FINER)
    moved = (finer - at)[np.isfinite(finer - at)]
    return _rms(moved) if len(moved) else None


def _changed_ends_m(trials: Sequence[SimTrial], change: Callable[[World], dict[str, float]]) -> FloatArray:
    return _ends_m(
        [replace(trial, world=trial.world.model_copy(update=change(trial.world))) for trial in trials]
    )


#: Changes of a world, in the order step, solver, softer, harder.
_CHANGES: tuple[Callable[[World], dict[str, float]], ...] = (
    lambda world: {"time_step_s": world.time_step_s / 2},
    lambda _: {"solver_tolerance": LOOSE_TOLERANCE},
    lambda world: {"contact_time_s": CONTACT_FACTOR * world.contact_time_s},
    lambda world: {"contact_time_s": world.contact_time_s / CONTACT_FACTOR},
)


#: Changes of a world that confirm the end of a walk, and measure the error of that end.
_FINER: tuple[Callable[[World], dict[str, float]], ...] = (
    lambda _: {"time_step_s": CONFIRM_STEP_S},
    lambda _: {"time_step_s": CONFIRM_STEP_S / 2},
)


def _duration_s(trials: Sequence[SimTrial]) -> float:
    durations_s = sorted({trial.plan.duration_s for trial in trials})
    if len(durations_s) != 1:
        got = ", ".join(f"{duration_s:g}" for duration_s in durations_s) + " s" if durations_s else "none"
        raise InputError(f"duration_s of the walks: got {got}; allowed: walks of one duration")
    return durations_s[0]


def simulation_uncertainty(
    robot: Robot | str | Path,
    world: World | str | Path | None = None,
    *,
    duration_s: float = 30.0,
) -> SimulationUncertainty:
    """Uncertainty of a robot's walks in a world, over some gaits and two failed legs; the default is flat.

    Raises what `uncertainty_of_walks` raises, and ReachError or LimitError for a robot that cannot walk.
    """
    model, place = as_robot(robot), as_world(world)
    trials = [_placed(model, place, leg, code, duration_s) for leg in LEGS for code in CODES]
    return uncertainty_of_walks(trials)


def _placed(robot: Robot, world: World, leg: int, code: int, duration_s: float) -> SimTrial:
    """A walk with a locked leg that trails; the robot is put down turned."""
    failure = parse_kind(leg, MEASURED_FAILURE)
    gait = make_gait(robot, str(code), failed_legs=(leg,))
    plan = TrialPlan(gait=gait, belief=failure, duration_s=duration_s)
    return SimTrial(robot=robot, plan=plan, failure=failure, world=world).put_down_turned()


def _ends_m(trials: Sequence[SimTrial]) -> FloatArray:
    ended = [result.deviation if result.status not in ENDLESS else None for result in run_sim_trials(trials)]
    return np.array([np.nan if deviation is None else deviation.signed for deviation in ended])


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))
