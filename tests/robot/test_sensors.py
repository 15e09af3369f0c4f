"""What a robot measures: by its file, and by the driver of its servos."""

from dataclasses import replace
from pathlib import Path

import pytest

from hexctl.backends.bus.family import find_family
from hexctl.errors import InputError
from hexctl.robot.formats.json_model import robot_from_json, robot_to_json
from hexctl.robot.loader import load_robot
from hexctl.robot.sensors import SENSORS, usual_sensors
from hexctl.robot.servos.drivers import BOARDS, FAMILIES
from tests.robots import edited_file, put, shipped


@pytest.mark.parametrize(
    ("name", "sensors"),
    [
        ("ant", SENSORS),
        ("pexod", SENSORS),
        ("phantomx-ax", ("joint_positions", "joint_loads")),
        ("lukas", ("joint_positions", "joint_loads")),
        ("jethexa", ("joint_positions",)),
        ("makeyourpet", ("foot_contacts",)),
        ("freenove-big", ()),
    ],
)
def test_a_robot_measures_what_its_servos_report(name: str, sensors: tuple[str, ...]) -> None:
    assert shipped(name).sensors == sensors


@pytest.mark.parametrize("driver", [*FAMILIES, *BOARDS])
def test_a_robot_has_loads_if_its_servos_report_them(driver: str) -> None:
    models = find_family(driver).models if driver in FAMILIES else ()
    for model, usual in [
        *((model, model.name) for model in models),
        *((model, None) for model in models[:1]),
    ]:
        reported = model.registers is not None and model.registers.effort is not None
        sensors = ("joint_positions", "joint_loads") if reported else ("joint_positions",)
        assert usual_sensors(driver, usual, foot_switches=False) == sensors
    if driver in BOARDS:
        assert usual_sensors(driver, None, foot_switches=True) == ("foot_contacts",)


def test_a_file_says_what_else_a_robot_measures(tmp_path: Path) -> None:
    file = edited_file(tmp_path, put("sensors", ["position", "imu"]), base="freenove-big")
    assert load_robot(file).sensors == ("imu", "position")


@pytest.mark.parametrize("wrong", [["imu", "imu"], ["sonar"], "imu"])
def test_sensors_that_cannot_be_are_refused(tmp_path: Path, wrong: object) -> None:
    with pytest.raises(InputError, match="sensors"):
        load_robot(edited_file(tmp_path, put("sensors", wrong)))
    with pytest.raises(InputError, match=r"robot\.sensors"):
        replace(shipped(), sensors=("sonar",))  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["freenove-big", "jethexa", "ant"])
def test_sensors_go_with_a_robot_but_do_not_change_its_body(name: str) -> None:
    robot = shipped(name)
    assert robot_from_json(robot_to_json(robot)) == robot
    everything = load_robot(name, all_sensors=True)
    assert everything.fingerprint == robot.fingerprint
    assert everything.sensors == SENSORS
