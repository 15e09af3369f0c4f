"""Servos that answer on a bus, without a robot file."""

import pytest

from hexctl.backends.bus.tools import scan_bus, set_servo_id
from hexctl.errors import InputError, RobotFaultError
from hexctl.simulators.register_servos import BusServo
from tests.backends.bus.boards import MODELS, a_map, bus_board, stance_counts

ALL_BUT_ONE = [
    f"mute:{leg}:{joint}"
    for leg in range(1, 7)
    for joint in ("coxa", "femur", "tibia")
    if (leg, joint) != (2, "coxa")
]


@pytest.mark.realtime
@pytest.mark.parametrize(("driver", "model"), MODELS)
def test_every_servo_is_found_with_what_it_is(driver: str, model: str) -> None:
    bus_map = a_map(driver, model)
    with bus_board(bus_map, "mute:1:femur", "hot:1:tibia:72") as board:
        found = scan_bus(board.path, driver, 1_000_000, ids=range(6))
    assert [each.servo_id for each in found] == [1, 3, 4, 5]
    assert {each.model for each in found} == {model}
    assert found[0].position == stance_counts(bus_map)[0]
    assert found[0].voltage_v == 12.0
    assert [each.temperature_c for each in found[:2]] == [35.0, 72.0]
    assert found[1].error in ("hot", "hardware alert (hot)")


@pytest.mark.realtime
def test_an_adapter_that_echoes_shows_no_servos_that_are_not_there() -> None:
    with bus_board(a_map(), "echo") as board:
        found = scan_bus(board.path, "feetech", 1_000_000, ids=(0, 7, 30))
    assert [each.servo_id for each in found] == [7]


@pytest.mark.long
@pytest.mark.realtime
def test_the_only_servo_on_a_bus_takes_an_id() -> None:
    for driver, model in (("feetech", "sts3215"), ("dynamixel", "xl430-w250")):
        with bus_board(a_map(driver, model), *ALL_BUT_ONE) as board:
            servo = set_servo_id(board.path, driver, 1_000_000, 40)
            assert (servo.servo_id, servo.model) == (40, model)


@pytest.mark.realtime
def test_with_more_servos_no_id_is_changed() -> None:
    with bus_board(a_map()) as board:
        with pytest.raises(InputError, match=r"servos that answer: got 1, 2, .*; allowed: exactly one"):
            set_servo_id(board.path, "feetech", 1_000_000, 40)
        assert [servo.servo_id for servo in board._servos] == list(range(1, 19))
    with pytest.raises(InputError, match="new_id: got 253; allowed: 0 to 252"):
        set_servo_id("/dev/nothing", "feetech", 1_000_000, 253)


@pytest.mark.realtime
def test_what_cannot_be_scanned_is_said_in_one_line() -> None:
    with pytest.raises(RobotFaultError, match="there is no port /dev/nothing"):
        scan_bus("/dev/nothing", "feetech", 1_000_000)
    with pytest.raises(InputError, match="driver: got 'hitec'; allowed: dynamixel, feetech, lx16a"):
        scan_bus("/dev/nothing", "hitec", 1_000_000)


@pytest.mark.realtime
def test_servos_of_lx16a_are_found() -> None:
    bus_map = a_map("lx16a", "lx16a")
    with bus_board(bus_map, "mute:1:femur", "hot:1:tibia:72", "echo") as board:
        found = scan_bus(board.path, "lx16a", 115_200, ids=range(6))
    assert [each.servo_id for each in found] == [1, 3, 4, 5]
    assert {(each.model, each.baud, each.voltage_v) for each in found} == {(None, 115_200, 7.4)}
    assert found[0].position == stance_counts(bus_map)[0]
    assert [each.temperature_c for each in found[:2]] == [35.0, 72.0]


@pytest.mark.realtime
def test_the_only_servo_of_lx16a_is_found_by_a_broadcast() -> None:
    with bus_board(a_map("lx16a", "lx16a"), *ALL_BUT_ONE) as board:
        servo = set_servo_id(board.path, "lx16a", 115_200, 40)
        assert servo.servo_id == 40
        assert board._servos[3].servo_id == 40
    with bus_board(a_map("lx16a", "lx16a")) as board:
        with pytest.raises(InputError, match=r"servos that answer: got several at once"):
            set_servo_id(board.path, "lx16a", 115_200, 40)
        assert [servo.servo_id for servo in board._servos] == list(range(1, 19))


@pytest.mark.realtime
def test_an_id_that_was_set_is_kept_without_power() -> None:
    with bus_board(a_map(), *ALL_BUT_ONE) as board:
        set_servo_id(board.path, "feetech", 1_000_000, 40)
        servo = board._servos[3]
        assert isinstance(servo, BusServo)
        servo.restart()
        assert servo.servo_id == 40
        assert servo.memory[55] == 1, "locked again"


@pytest.mark.realtime
def test_servos_are_found_at_the_baud_that_they_have() -> None:
    with bus_board(a_map("dynamixel", "xl430-w250"), baud=57_600) as board:
        asked: list[tuple[int, int]] = []
        assert scan_bus(board.path, "dynamixel", 1_000_000, ids=range(1, 4)) == []
        found = scan_bus(
            board.path,
            "dynamixel",
            1_000_000,
            57_600,
            ids=range(1, 4),
            progress=lambda *each: asked.append(each),
        )
    assert [(each.servo_id, each.baud) for each in found] == [(1, 57_600), (2, 57_600), (3, 57_600)]
    assert asked == [(number, 12) for number in range(12)]
