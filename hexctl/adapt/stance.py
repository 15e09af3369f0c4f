"""How a robot stands before its first trial: what `bayes` knows it by before it has walked."""

from dataclasses import replace

import numpy as np

from hexctl.adapt.stops import check_not_stopped
from hexctl.backends.sim.world import World
from hexctl.backends.table import BackendOptions, make_servos
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.plan import TrialPlan
from hexctl.control.trial import prepare, ticks_of
from hexctl.errors import CommandRefusedError, EStopError, SimulationDivergedError
from hexctl.robot.messages import FloatArray
from hexctl.robot.model import Robot

#: The last share of the settling over which is averaged: the robot has come to rest by then.
AT_REST = 0.25


def stance_sag_rad(servos: Guard, plan: TrialPlan) -> FloatArray | None:
    """Stand as before a trial of a plan, without its turn, and return how far each joint stays behind.

    What a joint was sent minus what it says, the mean over the rest, (18,). None, without a move, from a
    robot that only echoes what it was sent. Raises what `drive` raises.
    """
    if not servos.read().measured:
        return None
    log = TickLog()
    servos.rest()
    try:
        prepare(servos, replace(plan, self_rotation="none"), log)
    finally:
        # What comes now takes its time, and silence must not be taken for a failure.
        servos.rest()
    rest = max(1, round(AT_REST * ticks_of(servos, plan.settle_s)))
    return np.asarray((log["sent_rad"] - log["measured_rad"])[-rest:].mean(axis=0))


def sag_here_rad(servos: Guard, plan: TrialPlan) -> FloatArray | None:
    """Return how a robot stands where it is; None where that cannot be known.

    Raises RobotStoppedError for a robot that is stopped meanwhile, RobotFaultError for one that has gone.
    """
    try:
        return stance_sag_rad(servos, plan)
    except EStopError:
        check_not_stopped(servos)
        raise
    except CommandRefusedError:
        return None


def simulated_sag_rad(robot: Robot, world: World | None, plan: TrialPlan, seed: int) -> FloatArray | None:
    """Return how a simulated robot stands where its trials begin; None where it does not stay on its legs.

    It stands in a simulation of its own, with the sensor noise of trial 0.
    """
    options = BackendOptions(robot=robot, world=world, failure=plan.failure, seed=seed)
    try:
        with Guard(make_servos("sim", options)) as servos:
            return stance_sag_rad(servos, plan)
    except (EStopError, SimulationDivergedError):
        return None
