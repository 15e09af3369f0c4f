"""Single servos, moved by a few degrees: softly, back again, and with their torque as it was."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from hexctl.backends.bus.servo import Servo
from hexctl.backends.bus.tools import opened_line, the_servo
from hexctl.backends.mock import MockServos
from hexctl.control.calibration.servo_trial import TEST_DEG, held, try_servo, wiggle
from hexctl.errors import RobotFaultError
from hexctl.robot.servos.servo_models import DEFAULT_BAUDS
from hexctl.simulators.bus_board import BusBoard
from hexctl.simulators.register_servos import BusServo
from hexctl.types import JointTargets
from tests.backends.bus.boards import MODELS, a_map, bus_board, stance_counts
from tests.robots import shipped

pytestmark = pytest.mark.realtime

#: The joint that is tried, and its id.
JOINT, ID = 7, 8

FAMILIES = (*MODELS, ("lx16a", "lx16a"))


class StuckServos(MockServos):
    """A robot of which one joint does not move, and whose joints are recorded."""

    stuck = False

    def write(self, targets: JointTargets) -> JointTargets:
        positions = targets.joint_positions_rad.copy()
        if self.stuck:
            positions[JOINT] = self.robot.stance_angles_rad[JOINT]
        self.seen.append(positions)
        return super().write(JointTargets(positions, targets.stamp_s))

    def connect(self) -> None:
        self.seen: list[np.ndarray] = []
        super().connect()


@contextmanager
def _servo(
    driver: str, model: str, *faults: str, stuck: bool = False
) -> Iterator[tuple[Servo, BusBoard, StuckServos]]:
    moved = StuckServos(shipped("phantomx"))
    moved.stuck = stuck
    with (
        bus_board(a_map(driver, model), *faults, servos=moved) as board,
        opened_line(board.path, DEFAULT_BAUDS[driver]) as line,
    ):
        yield the_servo(line, driver, ID), board, moved


@pytest.mark.parametrize(("driver", "model"), FAMILIES)
def test_a_servo_moves_a_little_and_back_and_no_other_does(driver: str, model: str) -> None:
    with _servo(driver, model) as (servo, board, moved):
        assert abs(wiggle(servo)) == pytest.approx(5.0, abs=0.3)
        assert not any(each.holds for each in board._servos)
        angles = np.degrees(np.array(moved.seen) - moved.robot.stance_angles_rad)
        farthest = np.abs(angles).max(axis=0)
        assert farthest[JOINT] == pytest.approx(5.0, abs=0.5)
        assert np.delete(farthest, JOINT).max() < 0.5
        assert abs(angles[-1, JOINT]) < 0.5
        steps = np.abs(np.diff(angles[:, JOINT]))
        assert steps.max() < 2.0, "slowly"


@pytest.mark.parametrize(("driver", "model"), FAMILIES)
def test_a_good_servo_follows(driver: str, model: str) -> None:
    with _servo(driver, model) as (servo, board, _):
        trial = try_servo(servo)
        assert trial.followed
        assert trial.servo_id == ID
        assert sorted(trial.moved_deg) == pytest.approx([-TEST_DEG, TEST_DEG], abs=0.5)
        assert trial.error_deg < 1.0
        assert trial.speed_deg_s == pytest.approx(40, rel=0.35)
        assert trial.temperature_c == 35
        assert trial.voltage_v == trial.least_voltage_v == (7.4 if driver == "lx16a" else 12.0)
        assert not any(each.holds for each in board._servos)


def test_torque_speed_and_limits_are_as_they_were() -> None:
    for driver, model in (("dynamixel", "ax12a"), ("dynamixel", "xl430-w250"), ("feetech", "sts3215")):
        with _servo(driver, model) as (servo, board, _):
            real = board._servos[JOINT]
            assert isinstance(real, BusServo)
            table = real._table
            registers = [each for each in (table.speed, table.soft_torque, table.least) if each is not None]
            before = [real.number(each) for each in registers]
            with held(servo) as start:
                assert start == stance_counts(a_map(driver, model))[JOINT]
                assert real.holds
                assert table.speed is not None
                assert table.soft_torque is not None
                assert 0 < real.number(table.speed) <= 61
                assert real.number(table.soft_torque) == pytest.approx(0.4, abs=0.01)
            assert not real.holds
            assert [real.number(each) for each in registers] == before
            real.write(table.torque.address, b"\1")
            wiggle(servo)
            assert real.holds, "it held before"


def test_a_servo_that_does_not_follow_is_told() -> None:
    with _servo("feetech", "sts3215", stuck=True) as (servo, _, _moved):
        trial = try_servo(servo)
        assert not trial.followed
        assert trial.error_deg == pytest.approx(TEST_DEG, abs=0.5)
        assert np.abs(trial.moved_deg).max() < 0.5


def test_a_servo_that_must_not_be_moved_is_not() -> None:
    with _servo("dynamixel", "xl430-w250") as (servo, board, moved):
        real = board._servos[JOINT]
        assert isinstance(real, BusServo)
        real.memory[11] = 1
        with pytest.raises(RobotFaultError, match="id 8: its operating mode is 1, not 3"):
            wiggle(servo)
        assert not real.holds
        assert not moved.seen


def test_a_servo_that_takes_no_limit_of_its_speed_is_not_moved(monkeypatch: pytest.MonkeyPatch) -> None:
    """Moving softly is what the operator was told."""
    with _servo("dynamixel", "xl430-w250") as (servo, board, moved):
        odd = board._servos[JOINT]
        assert isinstance(odd, BusServo)
        refuses, access = odd._refuses, 7
        monkeypatch.setattr(odd, "_refuses", lambda at, data: access if at == 112 else refuses(at, data))
        with pytest.raises(RobotFaultError, match=r"servo with id 8 does not take a limit .* \(access\)"):
            wiggle(servo)
        assert not odd.holds
        assert odd.number(odd._table.soft_torque) == 1.0  # type: ignore[arg-type]
        assert moved.seen == []


def test_a_servo_beyond_its_limits_or_without_room_is_not_moved() -> None:
    for least, most, message in ((3000, 3500, "beyond the limits 3000 to 3500"), (-9, 9, "no room to move")):
        with _servo("feetech", "sts3215") as (servo, board, _):
            real = board._servos[JOINT]
            assert isinstance(real, BusServo)
            here = 0 if least > 0 else int(real.number(real._table.position))
            real.set(real._table.least, here + least)
            real.set(real._table.most, here + most)
            with pytest.raises(RobotFaultError, match=message):
                wiggle(servo)
            assert not real.holds


def test_an_overloaded_x_servo_says_why_it_does_not_hold() -> None:
    with (
        _servo("dynamixel", "xl430-w250", "overload:3:femur") as (servo, _, _moved),
        pytest.raises(RobotFaultError, match=r"id 8 does not hold \(hardware alert \(overload\)\)"),
    ):
        wiggle(servo)


def test_a_servo_that_is_not_there() -> None:
    with (
        bus_board(a_map()) as board,
        opened_line(board.path, 1_000_000) as line,
        pytest.raises(RobotFaultError, match=r"no servo with id 99 answers on .* `hexctl servos scan` shows"),
    ):
        the_servo(line, "feetech", 99)
