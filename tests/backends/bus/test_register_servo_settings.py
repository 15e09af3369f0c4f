"""What is stored in servos, at connect: set up, refused or said; and what an overload leaves."""

import time
from collections.abc import Callable

import numpy as np
import pytest

from hexctl.backends.bus.registers import Register, RegisterTable, table_of
from hexctl.backends.bus.servos import BusServos
from hexctl.errors import RobotFaultError
from hexctl.simulators.bus_board import BusBoard
from hexctl.simulators.register_servos import BusServo
from hexctl.types import JointTargets, RobotState
from tests.backends.bus.boards import a_map, bus_board, servos_on

pytestmark = pytest.mark.realtime

#: The servo that is not as the others.
ODD = 7
NAME = r"leg 3 femur \(id 8\)"


def _odd(board: BusBoard) -> BusServo:
    servo = board._servos[ODD]
    assert isinstance(servo, BusServo)
    return servo


def _store(board: BusBoard, register: Register | None, value: float) -> BusServo:
    """Let a setting of the odd servo be another for good."""
    servo = _odd(board)
    assert register is not None
    servo.set(register, value)
    servo._keep()
    return servo


def _walks(servos: BusServos, seconds: float, angle_rad: float = 0.0) -> RobotState:
    for _ in range(round(seconds / 0.02)):
        servos.clock.tick()
        servos.write(JointTargets(servos.robot.stance_angles_rad + angle_rad, servos.clock.now_s))
    return servos.read()


def _within(condition: Callable[[], bool], servos: BusServos, angle_rad: float = 0.0) -> bool:
    """Whether a condition comes to hold while the stance, off by an angle, is commanded."""
    deadline_s = time.monotonic() + 6.0
    while not condition():
        _walks(servos, 0.02, angle_rad)
        if time.monotonic() > deadline_s:
            return False
    return True


def _complaint(servos: BusServos) -> str:
    readings = servos.read().servos
    assert readings is not None
    return readings.errors[ODD]


def _table(model: str) -> RegisterTable:
    return table_of(model)


def test_a_robot_with_nothing_odd_has_no_warnings() -> None:
    for driver, model in (("dynamixel", "xl430-w250"), ("feetech", "sts3215")):
        with bus_board(a_map(driver, model)) as board, servos_on(board, a_map(driver, model)) as servos:
            _walks(servos, 0.5)
            beyond = [each for each in servos.read().warnings if "stored limits" not in each]
            assert beyond == []


@pytest.mark.parametrize(
    ("driver", "model", "mode", "kept"),
    [
        ("dynamixel", "xl430-w250", 4, 3),
        ("dynamixel", "xl320", 1, 2),
        ("feetech", "sts3215", 1, 1),  # whose lock keeps it from being saved
    ],
)
def test_a_servo_in_another_mode_is_set_to_position_mode_while_it_is_limp(
    driver: str, model: str, mode: int, kept: int
) -> None:
    bus_map, table = a_map(driver, model), _table(model)
    with bus_board(bus_map) as board:
        servo = _store(board, table.mode, mode)
        with servos_on(board, bus_map) as servos:
            warnings = servos.read().warnings
            said = f"set its operating mode from {mode} to {table.position_mode}: leg 3 femur (id 8)"
            assert said in warnings
            assert _within(lambda: servo.holds, servos)
        assert table.mode is not None
        servo.restart()
        assert servo.number(table.mode) == kept


def test_a_servo_in_another_mode_that_holds_is_refused() -> None:
    bus_map, table = a_map("dynamixel", "xl430-w250"), _table("xl430-w250")
    with bus_board(bus_map) as board:
        _store(board, table.mode, 1).set(table.torque, 1)
        with pytest.raises(RobotFaultError, match=rf"{NAME}: its operating mode is 1, not 3 \(position\)"):
            servos_on(board, bus_map).connect()
        assert _odd(board).number(table.torque) == 1, "nothing is switched"


@pytest.mark.parametrize(
    ("driver", "model", "settings", "message"),
    [
        ("dynamixel", "xl430-w250", {10: 1}, r"it counts in reverse \(register 10 is 1\)"),
        ("dynamixel", "xl430-w250", {10: 8}, r"goals switch its torque on \(register 10 is 8\)"),
        ("dynamixel", "ax12a", {6: 0, 7: 0, 8: 0, 9: 0}, "it is in wheel mode, with both angle limits at 0"),
        ("feetech", "scs0009", {9: 0, 10: 0, 11: 0, 12: 0}, "it is in wheel mode"),
    ],
)
def test_a_servo_that_would_not_steer_for_its_goals_is_refused(
    driver: str, model: str, settings: dict[int, int], message: str
) -> None:
    bus_map = a_map(driver, model)
    with bus_board(bus_map) as board:
        for address, value in settings.items():
            _store(board, Register(address), value)
        with pytest.raises(RobotFaultError, match=f"{NAME}: {message}"):
            servos_on(board, bus_map).connect()


def test_positions_beyond_one_turn_are_switched_off_and_the_lock_is_shut() -> None:
    bus_map, table = a_map(), _table("sts3215")
    with bus_board(bus_map) as board:
        servo = _store(board, table.flags, 0b11100)
        assert table.flags is not None
        assert table.unlock is not None
        servo.set(table.unlock, 0)
        with servos_on(board, bus_map) as servos:
            assert (
                "set its flag for positions beyond one turn off: leg 3 femur (id 8)" in servos.read().warnings
            )
        assert servo.number(table.flags) == 0b01100
        assert servo.number(table.unlock) == 1


@pytest.mark.parametrize(("driver", "model"), [("dynamixel", "xl430-w250"), ("dynamixel", "ax12a")])
def test_limits_in_a_servo_are_said_and_goals_end_there(driver: str, model: str) -> None:
    """These servos refuse goals beyond their limits, and would stay where they are."""
    bus_map, table = a_map(driver, model), _table(model)
    with bus_board(bus_map) as board:
        here = _odd(board).number(table.position)
        limit = here + np.sign(bus_map.signs[ODD]) * 15
        register = table.most if bus_map.signs[ODD] > 0 else table.least
        _store(board, register, limit)
        with servos_on(board, bus_map) as servos:
            stored = [each for each in servos.read().warnings if "its stored limits" in each]
            assert any("(id 8)" in each for each in stored)
            _walks(servos, 0.5)
            assert _within(lambda: _odd(board).number(table.position) == limit, servos, 0.2)
            assert _within(lambda: _complaint(servos).startswith("goal beyond the limits"), servos, 0.2)


def test_conditions_under_which_a_servo_does_not_let_go_are_said() -> None:
    bus_map, table = a_map("dynamixel", "xl430-w250"), _table("xl430-w250")
    with bus_board(bus_map) as board:
        _store(board, table.shutdown, 0b100000)
        with servos_on(board, bus_map) as servos:
            assert "it does not protect itself from heat: leg 3 femur (id 8)" in servos.read().warnings


@pytest.mark.parametrize(
    ("address", "value", "said"),
    [
        (34, 60, "after an overload it gives 60 % of its torque after 2 s above 80 %"),
        (35, 254, "after an overload it gives 20 % of its torque after 2.54 s above 80 %"),
        (36, 100, "after an overload it gives 20 % of its torque after 2 s above 100 %"),
    ],
)
def test_a_servo_that_protects_itself_less_from_an_overload_is_said(
    address: int, value: int, said: str
) -> None:
    """Registers of the vendor's memory table, by their addresses."""
    with bus_board(a_map()) as board:
        servo = _odd(board)
        servo.memory[address] = value
        usual = "from the factory 20 % of its torque after 2 s above 80 %"
        with servos_on(board, a_map()) as servos:
            assert f"{said}, {usual}: leg 3 femur (id 8)" in servos.read().warnings
        servo.memory[address] = 1  # sooner, or less
        with servos_on(board, a_map()) as servos:
            assert not any("overload" in each for each in servos.read().warnings)


@pytest.mark.parametrize(
    ("driver", "model"), [("dynamixel", "xl430-w250"), ("dynamixel", "ax12a"), ("feetech", "sts3215")]
)
def test_limits_that_an_earlier_program_left_are_said(driver: str, model: str) -> None:
    """As `hexctl servos test` leaves them when it is killed."""
    table, bus_map = _table(model), a_map(driver, model)
    assert table.soft_torque is not None
    assert table.speed is not None
    with bus_board(bus_map) as board:
        _odd(board).set(table.soft_torque, 0.4)
        _odd(board).set(table.speed, 60.0)
        with servos_on(board, bus_map) as servos:
            warnings = servos.read().warnings
    assert "its torque is limited to 40 % until it restarts: leg 3 femur (id 8)" in warnings
    assert "its speed is limited to 60 degrees/s: leg 3 femur (id 8)" in warnings


def test_an_overload_of_an_x_servo_is_told_with_its_reason_and_needs_a_restart() -> None:
    bus_map = a_map("dynamixel", "xl430-w250")
    with bus_board(bus_map, "overload:3:femur@2") as board, servos_on(board, bus_map) as servos:
        _walks(servos, 0.5)
        words = "hardware alert (overload): leg 3 femur (id 8)"
        assert _within(lambda: words in servos.read().warnings, servos)
        assert _within(lambda: "no torque: leg 3 femur (id 8)" in servos.read().warnings, servos)
    with bus_board(bus_map, "overload:3:femur") as board, servos_on(board, bus_map) as servos:
        said = "it has let go (overload); switch its power off and on: leg 3 femur (id 8)"
        assert said in servos.read().warnings


def test_an_overload_of_an_ax_servo_is_told_and_ends_with_the_next_walk() -> None:
    """It sets its torque limit to 0, and leaves its torque on."""
    bus_map, table = a_map("dynamixel", "ax12a"), _table("ax12a")
    assert table.torque_limit is not None
    with bus_board(bus_map, "overload:3:femur@2") as board, servos_on(board, bus_map) as servos:
        limp = "no torque: leg 3 femur (id 8)"
        assert _within(lambda: limp in servos.read().warnings, servos)
        assert _odd(board).number(table.torque) == 1
        _walks(servos, 0.3)
        assert not _odd(board).holds, "it is not switched on by itself"
        assert servos.disable_torque()
        time.sleep(0.2)
        assert _within(lambda: _odd(board).holds, servos)
        assert _odd(board).number(table.torque_limit) == 1
        assert _within(lambda: limp not in servos.read().warnings, servos)
