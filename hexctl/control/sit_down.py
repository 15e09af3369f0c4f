"""Sitting down: the body is lowered softly; joints may go limp afterwards."""

from collections.abc import Callable
from contextlib import suppress

from hexctl.control.controllers import SITTING_S, sitting_angles_rad
from hexctl.control.guard import Guard
from hexctl.errors import CommandRefusedError, EStopError
from hexctl.types import JointTargets
from hexctl.waiting import StopRequested, never_stop


class SittingMotion:
    """A motion from the present joint angles to those of a robot that sits, from `began_s` on its clock.

    Raises RobotFaultError for unknown joint angles.
    """

    def __init__(self, guard: Guard, began_s: float) -> None:
        self._guard, self._began_s = guard, began_s
        self._start_rad, self._end_rad = guard.accepted_rad().copy(), sitting_angles_rad(guard.robot)

    def step(self, now_s: float) -> bool:
        """Move on, and return whether the robot sits.

        Raises what `Guard.write_while_timed_out` raises.
        """
        share = min(1.0, (now_s - self._began_s) / SITTING_S)
        pose_rad = (1 - share) * self._start_rad + share * self._end_rad
        self._guard.write_while_timed_out(JointTargets(pose_rad, now_s))
        return share == 1


def sit_down(
    guard: Guard, stop_requested: StopRequested = never_stop, poll: Callable[[], None] | None = None
) -> None:
    """Lower the body and let the joints go limp, if the guard stopped the robot for heat or a low battery.

    A robot without a commander stays as it is, limp or not. One on a link, whose own guard stopped it,
    sits down by itself. A request to stop, asked for every tick after `poll`, or a graver stop holds the
    pose. Raises RobotFaultError when the link fails.
    """
    if not guard.stop_allows_sitting or not guard.expects_commands or guard.peek().stopped is not None:
        return
    motion, sits = SittingMotion(guard, guard.clock.now_s), False
    with suppress(EStopError, CommandRefusedError):
        while not sits:
            tick = guard.clock.tick()
            if poll is not None:
                poll()
            if stop_requested():
                guard.stop("estop")
            guard.read()
            sits = motion.step(tick.time_s)
        guard.disable_torque()
    guard.pause_watchdog()
