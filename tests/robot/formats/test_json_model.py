"""Robots as JSON: what comes back is equal, and anything else is refused in one line."""

import pytest

from hexctl.errors import InputError
from hexctl.robot.formats.json_model import robot_from_json, robot_to_json
from tests.robots import ROBOT_NAMES, shipped


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_an_equal_robot_comes_back(name: str) -> None:
    robot = shipped(name)
    back = robot_from_json(robot_to_json(robot))
    assert back == robot
    assert back.fingerprint == robot.fingerprint


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"version": 2}', '{"version": 1, "body": 3}', "null", "nonsense"]
)
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="robot description") as refused:
        robot_from_json(text)
    assert "\n" not in str(refused.value)


def test_a_robot_with_an_unknown_or_a_wrong_part_is_refused() -> None:
    whole = robot_to_json(shipped())
    for broken in (
        whole.replace('"size_m": 1.0', '"size_m": "x"', 1),
        whole.replace('"size_m"', '"length_m"', 1),
        whole.replace("0.08", "NaN", 1),
    ):
        assert broken != whole
        with pytest.raises(InputError, match="robot description"):
            robot_from_json(broken)
