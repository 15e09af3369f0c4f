"""Sits a robot down whose guard stopped it for hot servos or a low battery."""

from collections.abc import Callable
from contextlib import suppress

from hexctl.control.controllers import SITTING_S, Stand, sitting_angles_rad
from hexctl.control.guard import Guard
from hexctl.errors import CommandRefusedError, EStopError
from hexctl.types import JointTargets
from hexctl.waiting import StopRequested, never


def sit_down(
    guard: Guard, stop_requested: StopRequested = never, poll: Callable[[], None] | None = None
) -> None:
    """Lower the body and let the joints go limp, if the guard has just stopped the robot for that.

    A robot that nobody commands stays as it is, limp or not. One on a link, whose own guard stopped it,
    sits down by itself. A request to stop, asked for every tick after `poll`, or a graver stop holds the
    pose. Raises RobotFaultError when the link fails.
    """
    if not guard.sits or not guard.expects_commands or guard.peek().stopped is not None:
        return
    steps = max(1, round(SITTING_S / guard.clock.period_s))
    end_rad = sitting_angles_rad(guard.robot)
    motion = Stand(guard.robot, guard.accepted_rad(), steps, end_rad=end_rad)
    with suppress(EStopError, CommandRefusedError):
        for step in range(1, steps + 1):
            tick = guard.clock.tick()
            if poll is not None:
                poll()
            if stop_requested():
                guard.stop("estop")
            targets_rad = motion.targets_rad(step, guard.read())
            guard.write_while_timed_out(JointTargets(targets_rad, tick.time_s))
        guard.disable_torque()
    guard.pause_watchdog()
