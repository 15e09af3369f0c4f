"""The static deflection of the joints in the stance, observed before the first trial."""

import math
from contextlib import suppress
from dataclasses import replace

import numpy as np

from hexctl.adapt.optimizers.shipped import BAYES
from hexctl.adapt.prior.prior import Prior
from hexctl.adapt.runner import check_not_stopped
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.setting import Note, Setting
from hexctl.backends.registry import BackendOptions, make_servos
from hexctl.backends.sim.world import World
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.preparation import prepare, ticks_of
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import CommandRefusedError, EStopError, RobotFaultError
from hexctl.robot.model import Robot
from hexctl.types import FloatArray
from hexctl.waiting import StopRequested, never_stop

#: Last share of the settling time, over which deflections are averaged: the robot should be at rest by then.
AT_REST = 0.25

#: Root mean square drift of the joints between the halves of that time, above which they are not at rest.
MOVING_RAD = math.radians(0.5)

#: Attempts to stand up until the robot is at rest and every command was accepted.
ATTEMPTS = 2


def with_stance(
    spec: SessionSpec, setting: Setting, servos: Guard | None, stop_requested: StopRequested, note: Note
) -> SessionSpec:
    """Spec of a new session with the static deflection of the stance, if the optimizer can use it.

    A connected robot stands up for that, unless an operator places it: it then moves only on the operator's
    command, after the choice of the first gait. Without `servos` it is simulated; `note` is called if it
    cannot be measured.

    Raises the errors of `stance_deflection_rad`.
    """
    if spec.ask or spec.optimizer != BAYES:
        return spec
    if not isinstance(setting.prior, Prior) or setting.prior.sag_rad is None:
        return spec
    if servos is None:
        sag_rad = simulated_deflection_rad(setting.robot, setting.world, setting.plan, spec.seed)
    else:
        sag_rad = stance_deflection_rad(servos, setting.plan, stop_requested)
    if sag_rad is None:
        if not stop_requested():
            note("how the robot stands is not known (joints not measured, or not at rest)")
        return spec
    return replace(spec, sag_rad=[None if math.isnan(angle) else angle for angle in sag_rad.tolist()])


def stance_deflection_rad(
    servos: Guard, plan: TrialPlan, stop_requested: StopRequested = never_stop
) -> FloatArray | None:
    """Stand as before a trial of a plan, without its turn, and observe the static deflection of the joints.

    Returns:
        Angle sent minus angle measured, the mean at rest, (18,); NaN for a joint that only echoes. None if no
        joint is measured or a stop is requested, both without a move, or if the robot does not come to rest.

    Raises RobotStoppedError if the robot is stopped meanwhile, and what `drive` raises, but not for a command
    that was refused once.
    """
    if not servos.read().measured:
        return None
    rest = max(2, round(AT_REST * ticks_of(servos, plan.settle_s)))
    for _ in range(ATTEMPTS):
        if stop_requested():
            return None
        log = TickLog()
        with suppress(CommandRefusedError):
            _stand(servos, plan, log)
            if _is_at_rest(log["measured_rad"][-rest:]):
                return _behind_rad((log["commanded_rad"] - log["measured_rad"])[-rest:])
    return None


def _stand(servos: Guard, plan: TrialPlan, log: TickLog) -> None:
    servos.pause_watchdog()
    try:
        prepare(servos, replace(plan, self_rotation="none"), (log,))
    except EStopError:
        check_not_stopped(servos)
        raise
    finally:
        # What comes now takes its time, and silence must not be taken for a failure.
        servos.pause_watchdog()


def _is_at_rest(measured_rad: FloatArray) -> bool:
    half = len(measured_rad) // 2
    drift_rad = measured_rad[half:].mean(axis=0) - measured_rad[:half].mean(axis=0)
    return float(np.sqrt(np.mean(drift_rad**2))) <= MOVING_RAD


def _behind_rad(sags_rad: FloatArray) -> FloatArray | None:
    """Mean of deflections, (ticks, 18), NaN for unmeasured joints; None if no joint is."""
    echoed = (sags_rad == 0).all(axis=0)
    return None if echoed.all() else np.where(echoed, np.nan, sags_rad.mean(axis=0))


def simulated_deflection_rad(
    robot: Robot, world: World | None, plan: TrialPlan, seed: int
) -> FloatArray | None:
    """Static deflection in a separate simulation, with the noise of trial 0; None if the robot falls."""
    options = BackendOptions(robot=robot, world=world, failures=plan.failures, seed=seed)
    try:
        with Guard(make_servos("sim", options)) as servos:
            return stance_deflection_rad(servos, plan)
    except RobotFaultError:
        return None
