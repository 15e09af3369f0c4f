"""Ticks in which a robot is commanded to stand."""

from collections.abc import Callable
from typing import Any

from hexctl.backends.base import LegServos
from hexctl.types import JointTargets, RobotState


def next_state(servos: LegServos) -> RobotState:
    """State of the next tick."""
    servos.clock.tick()
    return servos.read()


def command(servos: LegServos, offset_rad: float = 0.0) -> None:
    """Command the stance, off by an angle."""
    servos.write(JointTargets(servos.robot.stance_angles_rad + offset_rad, servos.clock.now_s))


def stand(servos: LegServos, ticks: int, offset_rad: float = 0.0) -> RobotState:
    """State after some ticks in which the stance, off by an angle, is commanded."""
    for _ in range(ticks):
        next_state(servos)
        command(servos, offset_rad)
    return servos.read()


def until(
    servos: LegServos,
    condition: Callable[[RobotState], Any],
    *,
    write: bool = True,
    offset_rad: float = 0.0,
    ticks: int = 500,
) -> RobotState:
    """State of the first tick in which a condition holds, while a pose is commanded, or nothing is."""
    for _ in range(ticks):
        state = next_state(servos)
        if condition(state):
            return state
        if write:
            command(servos, offset_rad)
    raise AssertionError(state)
