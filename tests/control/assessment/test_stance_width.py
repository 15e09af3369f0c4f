"""The stance width that a check proposes: the servos carry the robot on any five legs."""

import math

import pytest

from hexctl.control.assessment.stance_width import stance_width
from hexctl.gait.gait import make_gait
from hexctl.robot.configs import read_mapping
from hexctl.robot.loader import load_robot_file, robot_of_content
from hexctl.robot.model import in_stance_of
from tests.robots import ROBOT_NAMES, shipped


@pytest.mark.parametrize(("name", "gait"), [*((name, "tripod") for name in ROBOT_NAMES), ("lukas", "demo")])
def test_shipped_robots_stand_as_is_proposed(name: str, gait: str) -> None:
    found = stance_width(shipped(name), make_gait(shipped(name), gait))
    assert found["proposed_outward_m"] == found["stance_outward_m"]
    assert (found["five_leg_drive"] or math.inf) <= 1


def test_no_stance_is_proposed_for_a_robot_that_tips_over_on_five_legs() -> None:
    file = load_robot_file("ant")
    content = read_mapping(file.path)
    tips = robot_of_content(
        {**content, "body": {**content["body"], "mass_kg": 5.0, "com_m": [0.3, 0.0, 0.0]}}, file.path
    )
    found = stance_width(tips, make_gait(tips, "tripod"))
    assert found["five_leg_drive"] is found["proposed_five_leg_drive"] is None


@pytest.mark.slow
def test_a_stance_too_wide_for_five_legs_gets_the_widest_that_its_servos_carry() -> None:
    robot = shipped("phantomx")
    wide = in_stance_of(robot, 0.15)
    found = stance_width(wide, make_gait(wide, "tripod"))
    assert (found["five_leg_drive"] or 0.0) > 1 >= (found["proposed_five_leg_drive"] or math.inf)
    assert found["proposed_outward_m"] == pytest.approx(robot.stance_outward_m)
    wider = in_stance_of(wide, robot.stance_outward_m + 0.02 * 0.15)
    assert (stance_width(wider, make_gait(wide, "tripod"))["five_leg_drive"] or 0.0) > 1
