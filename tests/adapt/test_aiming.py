"""Whatever way a robot points: seen from its body all walks are the same, and in the world they lead home."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.adapt.aiming import aimed, as_placed, body_heading_rad
from hexctl.adapt.arena import Arena
from hexctl.adapt.prior.question import Question
from hexctl.control.plan import SELF_ROTATIONS, TrialPlan
from hexctl.control.turning import check_plan, turn_needed_rad
from hexctl.errors import RobotFaultError
from hexctl.gait.gait import make_gait
from hexctl.robot.failure import Failure
from hexctl.robot.rotations import wrapped_rad
from hexctl.types import RobotState
from tests.robots import shipped

ROBOT = shipped()
ARENA = Arena(home_m=(0.5, -0.2), radius_m=3.0)
ANGLES = st.floats(-math.pi, math.pi)
ROTATIONS = st.sampled_from(SELF_ROTATIONS)


def plan_of(self_rotation: str, leg: int = 5, heading_rad: float = 0.3) -> TrialPlan:
    gait = make_gait(ROBOT, "demo")
    return TrialPlan(
        gait=gait, heading_rad=heading_rad, failure=Failure(leg=leg), self_rotation=self_rotation
    )


def standing(x: float, y: float, yaw_rad: float) -> RobotState:
    quaternion = np.array([math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2)])
    position = np.array([x, y, 0.1])
    return RobotState(
        ROBOT.stance_angles_rad, 0.0, True, base_position_world=position, base_quaternion_world=quaternion
    )


def apart_deg(one_rad: float, other_rad: float) -> float:
    return abs(math.degrees(wrapped_rad(one_rad - other_rad)))


@given(ROTATIONS, st.integers(1, 6), st.floats(-3, 3), st.floats(-3, 3), ANGLES, st.booleans())
def test_the_walk_leads_through_home_and_is_the_same_seen_from_the_body(
    self_rotation: str, leg: int, x: float, y: float, yaw_rad: float, outward: bool
) -> None:
    plan, state = plan_of(self_rotation, leg), standing(x, y, yaw_rad)
    turned = aimed(plan, ROBOT, state, ARENA, outward=outward)
    seen_from_body = turned.motion(turn_needed_rad(ROBOT, turned)).heading_rad
    assert apart_deg(seen_from_body, body_heading_rad(plan, ROBOT)) < 1e-6
    assert abs(turn_needed_rad(ROBOT, turned)) <= math.pi + 1e-9
    if math.hypot(x - 0.5, y + 0.2) > 0.06:
        home_rad = math.atan2(-0.2 - y, 0.5 - x) + (math.pi if outward else 0.0)
        assert apart_deg(yaw_rad + turned.heading_rad, home_rad) < 1e-6


@pytest.mark.parametrize("leg", range(1, 7))
@pytest.mark.parametrize(("self_rotation", "off_deg"), [("rear", 180.0), ("front", 0.0)])
def test_the_failed_leg_points_where_it_should(leg: int, self_rotation: str, off_deg: float) -> None:
    plan = aimed(plan_of(self_rotation, leg), ROBOT, standing(1.0, 1.0, 2.0), ARENA)
    leg_world_rad = 2.0 + turn_needed_rad(ROBOT, plan) + float(ROBOT.leg_azimuths_rad[leg - 1])
    travel_world_rad = 2.0 + plan.heading_rad
    assert apart_deg(leg_world_rad, travel_world_rad + math.radians(off_deg)) < 1e-6


@given(ROTATIONS, ANGLES)
def test_at_home_nothing_turns(self_rotation: str, yaw_rad: float) -> None:
    for outward in (False, True):
        plan = aimed(plan_of(self_rotation), ROBOT, standing(0.5, -0.2, yaw_rad), ARENA, outward=outward)
        assert turn_needed_rad(ROBOT, plan) == pytest.approx(0.0, abs=1e-9)


def test_a_plan_that_can_be_walked_can_be_walked_in_every_direction() -> None:
    for yaw_rad in np.linspace(-3, 3, 13):
        check_plan(ROBOT, aimed(plan_of("rear"), ROBOT, standing(1.0, 0.0, float(yaw_rad)), ARENA))


@pytest.mark.parametrize("self_rotation", SELF_ROTATIONS)
def test_a_robot_that_was_put_down_does_not_turn(self_rotation: str) -> None:
    plan = plan_of(self_rotation)
    placed = as_placed(plan, ROBOT)
    assert turn_needed_rad(ROBOT, placed) == 0
    assert apart_deg(placed.motion(0.0).heading_rad, body_heading_rad(plan, ROBOT)) < 1e-6


@pytest.mark.parametrize("self_rotation", ["rear", "front"])
def test_the_prior_is_asked_the_same_whatever_way_a_trial_goes(self_rotation: str) -> None:
    plan = plan_of(self_rotation)
    turned = aimed(plan, ROBOT, standing(2.0, -1.0, 1.0), ARENA)
    assert Question.of(ROBOT, turned) == Question.of(ROBOT, plan)


def test_a_robot_that_lost_its_pose_cannot_aim() -> None:
    with pytest.raises(RobotFaultError, match="no longer knows"):
        aimed(plan_of("rear"), ROBOT, RobotState(ROBOT.stance_angles_rad, 0.0, True), ARENA)
