"""Where a robot that stays where it is walks next. Relative to the body every walk is the same."""

import math
from dataclasses import replace

from hexctl.adapt.arena import Arena
from hexctl.control.plan import TrialPlan
from hexctl.control.turning import turn_needed_rad
from hexctl.errors import RobotFaultError
from hexctl.robot.model import Robot
from hexctl.robot.rotations import wrapped_rad, yaw_rad
from hexctl.types import RobotState


def body_heading_rad(plan: TrialPlan, robot: Robot) -> float:
    """Return the direction of travel as seen from the body once it has turned as a plan wants it."""
    return plan.heading_rad - turn_needed_rad(robot, plan)


def aimed(
    plan: TrialPlan, robot: Robot, state: RobotState, arena: Arena, *, outward: bool = False
) -> TrialPlan:
    """Return a plan turned so that its walk goes through the middle of the arena, or away from it.

    At the middle it goes where the body need not turn. Raises RobotFaultError without a pose.
    """
    if state.base_position_world is None or state.base_quaternion_world is None:
        raise RobotFaultError("the robot no longer knows where it is")
    yaw = float(yaw_rad(state.base_quaternion_world))
    body_rad = body_heading_rad(plan, robot)
    as_it_stands_rad = yaw + body_rad
    away_rad = math.pi if outward else 0.0
    aim_rad = arena.aim_rad(state.base_position_world, as_it_stands_rad - away_rad) + away_rad
    turn_rad = wrapped_rad(aim_rad - as_it_stands_rad)
    return replace(plan, heading_rad=turn_rad + body_rad, turn_rad=turn_rad)


def as_placed(plan: TrialPlan, robot: Robot) -> TrialPlan:
    """Return a plan for a robot that somebody has put down the way it would turn by itself."""
    return replace(plan, heading_rad=body_heading_rad(plan, robot), turn_rad=0.0)
