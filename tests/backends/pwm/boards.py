"""Simulated boards of hobby servos: in a thread of the test, or in memory on simulated time."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

from hexctl.backends.base import LegServos
from hexctl.backends.clock import WallClock
from hexctl.backends.mock import MockServos
from hexctl.backends.pwm.pca9685 import Pca9685Servos
from hexctl.backends.pwm.servo2040 import Servo2040Servos
from hexctl.robot.servos.pwm_map import PwmMap, pwm_map_of
from hexctl.robot.servos.servo_schema import ServosSection
from hexctl.simulators.board_faults import parse_fault
from hexctl.simulators.pca9685_board import Pca9685Board
from hexctl.simulators.servo2040_board import Servo2040Board
from tests.backends.bus.boards import MemoryDevice, running
from tests.backends.fake_time import FakeTime, Standing
from tests.robots import shipped


def a_map(driver: str = "servo2040", **section: Any) -> PwmMap:
    """Servos of the robot ant, whose horns are mounted so that its stance fits into their travel."""
    mounted = {"tibia": {"offset_deg": 40}, **section}
    return pwm_map_of(ServosSection.model_validate(mounted), driver)


@contextmanager
def servo2040_board(
    *faults: str, firmware: str = "stock", servos: LegServos | None = None, pwm_map: PwmMap | None = None
) -> Iterator[Servo2040Board]:
    """A servo2040 that runs meanwhile, of servos without a robot unless others are given."""
    board = Servo2040Board(
        MockServos(shipped()) if servos is None else servos,
        a_map() if pwm_map is None else pwm_map,
        firmware=firmware,
        faults=tuple(parse_fault(fault, Servo2040Board.kinds) for fault in faults),
    )
    with running(board):
        yield board


@contextmanager
def pca9685_board(
    *faults: str,
    servos: LegServos | None = None,
    bits_per_s: int = 400_000,
    pwm_map: PwmMap | None = None,
) -> Iterator[Pca9685Board]:
    """Boards PCA9685 that run meanwhile, of servos without a robot unless others are given."""
    board = Pca9685Board(
        MockServos(shipped()) if servos is None else servos,
        a_map("pca9685") if pwm_map is None else pwm_map,
        bits_per_s=bits_per_s,
        faults=tuple(parse_fault(fault, Pca9685Board.kinds) for fault in faults),
    )
    with running(board):
        yield board


class MemoryServo2040(MemoryDevice):
    """A simulated servo2040 in memory, which moves a mock robot unless other servos are given."""

    def __init__(self, servos: LegServos | None, time: FakeTime, **options: Any) -> None:
        robot = MockServos(shipped(), clock=WallClock(time=Standing(time))) if servos is None else servos
        self.board = Servo2040Board(robot, **options)
        super().__init__(self.board, time)


@contextmanager
def memory_servo2040(
    *faults: str, firmware: str = "stock", servos: LegServos | None = None, pwm_map: PwmMap | None = None
) -> Iterator[MemoryServo2040]:
    """A servo2040 in memory, found at its path meanwhile; clocks that nobody gave are on its time."""
    device = MemoryServo2040(
        servos,
        FakeTime(),
        pwm_map=a_map() if pwm_map is None else pwm_map,
        firmware=firmware,
        faults=tuple(parse_fault(fault, Servo2040Board.kinds) for fault in faults),
    )
    with (
        patch("hexctl.backends.pwm.servo2040.SerialLine", device.open),
        patch("hexctl.backends.ticked_servos.WallClock", lambda: WallClock(time=device.time)),
    ):
        yield device


def servos_on(board: MemoryServo2040 | Servo2040Board, pwm_map: PwmMap | None = None) -> Servo2040Servos:
    """Servos of the controller's end, not connected."""
    used, clock = a_map() if pwm_map is None else pwm_map, None
    if isinstance(board, MemoryServo2040):
        clock = WallClock(time=board.time)
    return Servo2040Servos(shipped(), pwm_map=used, port=board.path, clock=clock)


def i2c_servos_on(board: Pca9685Board) -> Pca9685Servos:
    """Servos of the controller's end, not connected."""
    return Pca9685Servos(shipped(), pwm_map=a_map("pca9685"), port=board.path)
