"""Options of a bus: where it is by what is given, by a robot file, and by what is usual."""

from pathlib import Path
from typing import Any

import pytest

from hexctl.backends.bus.bus_options import BusAddress, BusOptions, IdentificationOptions, ScanOptions
from hexctl.errors import InputError, WrongTypeError
from tests.robots import edited_file, put


@pytest.fixture
def robot(tmp_path: Path) -> str:
    section = {"driver": "lx16a", "port": "/dev/ttyUSB7", "baud": 57_600, "model": "lx224"}
    return str(edited_file(tmp_path, put("servos", section), base="phantomx"))


def test_a_bus_is_where_the_options_say_else_the_robot_file(robot: str) -> None:
    assert BusOptions(robot=robot).address() == BusAddress("lx16a", "/dev/ttyUSB7", 57_600)
    assert BusOptions(robot=robot, connect="x", baud=9600).address() == BusAddress("lx16a", "x", 9600)
    assert BusOptions(driver="feetech", connect="x").address() == BusAddress("feetech", "x", 1_000_000)
    assert BusOptions(driver="feetech", connect="x:57600").address().baud == 57_600


def test_a_scan_asks_at_one_baud_rate_or_at_all_that_are_usual(robot: str) -> None:
    for bauds, asked in ((None, (57_600,)), (115_200, (115_200,)), ("all", (115_200,))):
        options = ScanOptions(robot=robot, bauds=bauds)
        assert options.bauds_at(options.address()) == asked


def test_joints_are_those_of_the_robot_file(robot: str) -> None:
    servo_map = BusOptions(robot=robot).servo_map()
    assert servo_map is not None
    assert servo_map.ids.tolist() == list(range(1, 19))
    assert BusOptions(driver="feetech", connect="x").servo_map() is None


def test_only_servos_that_report_no_model_are_given_one(robot: str) -> None:
    assert IdentificationOptions(robot=robot).unreported_model("lx16a") == "lx224"
    assert IdentificationOptions(robot=robot, model="hts35h").unreported_model("lx16a") == "hts35h"
    assert IdentificationOptions().unreported_model("lx16a") is None
    assert IdentificationOptions(robot=robot).unreported_model("feetech") is None
    with pytest.raises(InputError, match="model: got hts35h with feetech; allowed: with lx16a"):
        IdentificationOptions(model="hts35h").unreported_model("feetech")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"connect": "x"}, "driver: got none; allowed: dynamixel, feetech, lx16a"),
        ({"driver": "feetech"}, "connect: got none; allowed: the port of the bus"),
        ({"driver": "hitec"}, "driver: got hitec; allowed: dynamixel, feetech, lx16a"),
        ({"driver": "feetech", "connect": "x", "baud": 9}, "baud: got 9; allowed: 1200 to 4500000 baud"),
        ({"robot": "freenove-big"}, "robot: got freenove-big, whose hobby servos"),
    ],
)
def test_a_bus_that_cannot_be_is_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        BusOptions(**options).address()


def test_another_driver_than_that_of_the_robot_file_is_refused(robot: str) -> None:
    with pytest.raises(InputError, match="driver: got feetech; allowed: lx16a, with this robot file"):
        BusOptions(robot=robot, driver="feetech").address()
    with pytest.raises(WrongTypeError, match="connect"):
        BusOptions(connect=5)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="output: got it with robot"):
        IdentificationOptions(robot=robot, output="x")
