"""Ticks in which a robot is commanded to stand."""

from collections.abc import Callable
from typing import Any

from hexctl.backends.base import LegServos
from hexctl.types import JointTargets, RobotState


def until(
    servos: LegServos, condition: Callable[[RobotState], Any], *, write: bool = True, offset_rad: float = 0.0
) -> RobotState:
    """State of the first tick in which a condition holds, while a pose is commanded, or nothing is."""
    for _ in range(500):
        servos.clock.tick()
        state = servos.read()
        if condition(state):
            return state
        if write:
            servos.write(JointTargets(servos.robot.stance_angles_rad + offset_rad, servos.clock.now_s))
    raise AssertionError(state)
