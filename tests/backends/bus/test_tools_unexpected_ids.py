"""Ids that are not those of the robot file, as a user notices them at connect."""

import pytest

from hexctl.backends.bus.tools import id_differences, ids_around, joint_of
from hexctl.errors import RobotFaultError
from hexctl.robot.schema import ServosSection
from hexctl.robot.servos.bus_map import BusMap, bus_map_of
from hexctl.types import JOINT_NAMES
from tests.backends.bus.boards import bus_board, servos_on

FAMILIES = (("dynamixel", "ax12a"), ("dynamixel", "xl430-w250"), ("feetech", "sts3215"), ("lx16a", "lx16a"))


def _ids_from(first: int, driver: str = "feetech", model: str = "sts3215") -> BusMap:
    joints = {name: {"id": first + place} for place, name in enumerate(JOINT_NAMES)}
    kinds = {"femur": {"offset_deg": -10, "sign": -1}, "tibia": {"offset_deg": 40}}
    return bus_map_of(ServosSection.model_validate({"model": model, **kinds, **joints}), driver)


@pytest.mark.slow
@pytest.mark.parametrize(("driver", "model"), FAMILIES)
def test_ids_that_are_off_by_one_are_refused(driver: str, model: str) -> None:
    with bus_board(_ids_from(2, driver, model)) as board:
        with pytest.raises(RobotFaultError) as refused:
            servos_on(board, _ids_from(1, driver, model)).connect()
        assert not any(servo.holds for servo in board._servos)
    assert str(refused.value) == (
        "leg 1 coxa (id 1) does not answer, and id 19 does, which is in no joint; compare the ids (hexctl "
        "servos scan --robot FILE)"
    )


@pytest.mark.slow
def test_all_ids_that_differ_are_named() -> None:
    with (
        bus_board(_ids_from(3)) as board,
        pytest.raises(RobotFaultError, match=r"femur \(id 2\) do not answer, and ids 19, 20 do, which are"),
    ):
        servos_on(board, _ids_from(1)).connect()


@pytest.mark.slow
def test_a_servo_that_lost_its_id_beside_one_that_is_mute_is_refused() -> None:
    ids = _ids_from(21)
    with (
        bus_board(ids, "lost-id:3:tibia", "mute:2:coxa") as board,
        pytest.raises(RobotFaultError, match=r"leg 3 tibia \(id 29\) do not answer, and id 1 does"),
    ):
        servos_on(board, ids).connect()


@pytest.mark.slow
def test_a_mute_servo_alone_is_no_wrong_id() -> None:
    ids = _ids_from(1)
    with bus_board(ids, "mute:2:coxa") as board, servos_on(board, ids) as servos:
        assert "mute: leg 2 coxa (id 4)" in servos.read().warnings


def test_ids_are_compared_with_those_of_the_joints() -> None:
    ids = _ids_from(21)
    assert ids_around(ids) == [1, *range(3, 21), *range(39, 57)]
    assert (joint_of(ids, 22), joint_of(ids, 1)) == (JOINT_NAMES[1], None)
    assert id_differences(ids, range(21, 39)) == []
    assert id_differences(ids, [*range(22, 39), 1, 40]) == [
        "no answer: leg 1 coxa (id 21)",
        "in no joint of the robot file: id 1, 40",
    ]
