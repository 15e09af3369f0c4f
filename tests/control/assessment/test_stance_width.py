"""The stance width that a check proposes: the servos carry the robot on any five legs."""

import pytest

from hexctl.control.assessment.stance_width import stance_width
from hexctl.gait.gait import make_gait
from hexctl.robot.configs import read_mapping
from hexctl.robot.loader import load_robot_file, robot_of_content
from hexctl.robot.model import in_stance_of
from tests.robots import ROBOT_NAMES, shipped


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_shipped_robots_stand_as_is_proposed(name: str) -> None:
    found = stance_width(shipped(name), make_gait(shipped(name), "tripod"))
    assert found.proposed_m == found.outward_m
    assert found.drive <= 1


@pytest.mark.slow
def test_a_stance_too_wide_for_five_legs_gets_the_widest_that_its_servos_carry() -> None:
    file = load_robot_file("phantomx")
    content = read_mapping(file.path)
    wide = robot_of_content({**content, "stance": {**content["stance"], "outward_m": 0.15}}, file.path)
    assert in_stance_of(file.robot, 0.15).fingerprint == wide.fingerprint
    found = stance_width(wide, make_gait(wide, "tripod"))
    wider = in_stance_of(wide, found.proposed_m + 0.02 * found.outward_m)
    assert found.drive > 1 >= found.proposed_drive
    assert stance_width(wider, make_gait(wide, "tripod")).drive > 1
    assert found.proposed_m == pytest.approx(file.robot.stance_outward_m)
