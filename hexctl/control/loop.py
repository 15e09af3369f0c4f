"""The tick: read, think, guard, write, record."""

import time
from collections.abc import Callable
from typing import Protocol

from hexctl.backends.clock import Tick
from hexctl.control.controllers import Controller
from hexctl.control.guard import Guard
from hexctl.types import FloatArray, JointTargets, RobotState


class Recorder(Protocol):
    """Keeps what happened in a tick."""

    def record(self, tick: Tick, state: RobotState, wanted_rad: FloatArray, sent: JointTargets) -> None:
        """Keep one tick: the state read, what the controller wanted, what was sent."""

    def took(self, work_s: float) -> None:
        """Keep how long the work of the last tick took, its recording included."""


Until = Callable[[int, RobotState], bool]


def drive(
    servos: Guard, controller: Controller, recorder: Recorder, until: Until, *, first_step: int = 0
) -> tuple[int, RobotState]:
    """Run the controller on the servos until told otherwise; return the last step and state.

    Args:
        servos: guarded, connected servos; their clock sets the pace.
        controller: gives the targets for steps, ticks since it took over.
        recorder: keeps every tick.
        until: asked after each write with the step and the state; True ends the drive.
        first_step: where the steps begin, for a controller that goes on.

    Raises EStopError when the guard stops the robot, CommandRefusedError when a target came too late, and
    RobotFaultError when the robot or the simulation fails.
    """
    tick = servos.clock.tick()
    zero_index = tick.index - first_step
    while True:
        began_s = time.perf_counter()
        step = tick.index - zero_index
        state = servos.read()
        wanted_rad = controller.targets_rad(step, state)
        sent = servos.write(JointTargets(wanted_rad, tick.time_s))
        recorder.record(tick, state, wanted_rad, sent)
        recorder.took(time.perf_counter() - began_s)
        if until(step, state):
            return step, state
        tick = servos.clock.tick()
