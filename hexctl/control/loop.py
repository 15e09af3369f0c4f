"""The control loop: read, compute, guard, write, record."""

import time
from collections.abc import Callable, Sequence
from typing import Protocol

from hexctl.backends.clock import Tick
from hexctl.control.controllers import Controller
from hexctl.control.guard import Guard
from hexctl.types import FloatArray, JointTargets, RobotState, as_joint_angles


class TickObserver(Protocol):
    """Sees every tick of a loop. It runs within the tick and must neither block nor raise."""

    def record(self, tick: Tick, state: RobotState, requested_rad: FloatArray, sent: JointTargets) -> None:
        """Take one tick: the state read, the controller's targets, and the targets sent."""

    def took(self, work_s: float) -> None:
        """Take the duration of the last tick's work, observers included; most observers need none."""
        return


#: Called after each write with step and state; True ends the loop.
Until = Callable[[int, RobotState], bool]


def run_controller(
    servos: Guard,
    controller: Controller,
    observers: Sequence[TickObserver] = (),
    *,
    until: Until | None = None,
    first_step: int = 0,
) -> tuple[int, RobotState]:
    """Run a controller on connected servos, at their clock, until it is done; the last step and state.

    `until` ends the loop early. A controller that continues has another first step. Raises EStopError when
    the guard stops the robot, CommandRefusedError when a target came too late, RobotFaultError when the robot
    or the simulation fails, InputError for other targets than 18 joint angles.
    """
    tick = servos.clock.tick()
    zero_index = tick.index - first_step
    while True:
        step = tick.index - zero_index
        state = run_step(servos, controller, tick, step, observers)
        if controller.done(step, state) or (until is not None and until(step, state)):
            return step, state
        tick = servos.clock.tick()


def run_step(
    servos: Guard, controller: Controller, tick: Tick, step: int, observers: Sequence[TickObserver] = ()
) -> RobotState:
    """One step of a controller at a tick; its state. Raises what `run_controller` raises."""
    began_s = time.perf_counter()
    state = servos.read()
    requested_rad = as_joint_angles(controller.targets_rad(step, state), "controller", leading_shape=())
    sent = servos.write(JointTargets(requested_rad, tick.time_s))
    for observer in observers:
        observer.record(tick, state, requested_rad, sent)
    work_s = time.perf_counter() - began_s
    for observer in observers:
        observer.took(work_s)
    return state
