"""Measured uncertainty of the simulation: how far walks end elsewhere with another computation."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from hexctl.backends.base import as_robot
from hexctl.backends.sim.world import World, as_world
from hexctl.control.batch import SimTrial, run_sim_trials
from hexctl.control.scoring.uncertainty_store import (
    CONFIRM_STEP_S,
    MEASURED_FAILURE,
    SimulationUncertainty,
)
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
    step = _ends_m(trials, lambda world: {"time_step_s": world.time_step_s / 2}) - plain
    solver = _ends_m(trials, lambda _: {"solver_tolerance": LOOSE_TOLERANCE}) - plain
    softer = _ends_m(trials, lambda world: {"contact_time_s": CONTACT_FACTOR * world.contact_time_s}) - plain
    harder = _ends_m(trials, lambda world: {"contact_time_s": world.contact_time_s / CONTACT_FACTOR}) - plain
    known = np.isfinite(step + solver + softer + harder)
    if not known.any():
        raise InputError("walks: got none that walks to its end; allowed: at least one that does")
    confirmed = _ends_m(trials, lambda _: {"time_step_s": CONFIRM_STEP_S})
    confirmed = _ends_m(trials, lambda _: {"time_step_s": CONFIRM_STEP_S / 2}) - confirmed
    confirmed = confirmed[np.isfinite(confirmed)]
    return SimulationUncertainty(
        step_m=_rms(step[known]),
        solver_m=_rms(solver[known]),
        contact_m=_rms(np.concatenate([softer[known], harder[known]])),
        confirmed_m=_rms(confirmed) if len(confirmed) else None,
        walks=int(known.sum()),
        duration_s=duration_s,
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
    plan = TrialPlan(gait=gait, failures=(failure,), duration_s=duration_s)
    return SimTrial(robot=robot, plan=plan, failures=failure, world=world).put_down_turned()


def _ends_m(
    trials: Sequence[SimTrial], change: Callable[[World], dict[str, float]] = lambda _: {}
) -> FloatArray:
    """Signed deviations at the ends of walks in changed worlds; NaN without an end."""
    worlds = (trial.world.model_copy(update=change(trial.world)) for trial in trials)
    changed = [replace(trial, world=world) for trial, world in zip(trials, worlds, strict=True)]
    ended = [result.deviation if result.status not in ENDLESS else None for result in run_sim_trials(changed)]
    return np.array([np.nan if deviation is None else deviation.signed for deviation in ended])


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))
