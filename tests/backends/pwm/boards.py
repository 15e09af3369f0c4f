"""Simulated boards of hobby servos: in a thread of the test, or in memory on simulated time."""

import os
import random
import tty
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pkgutil import resolve_name
from typing import Any
from unittest.mock import patch

import pytest

from hexctl.backends.base import LegServos
from hexctl.backends.clock import WallClock
from hexctl.backends.mock import MockServos
from hexctl.backends.pwm.pca9685 import Pca9685Servos
from hexctl.backends.pwm.pulse_board import find_board, pwm_map_of
from hexctl.backends.pwm.pwm_map import PwmMap
from hexctl.backends.pwm.servos import PwmServos
from hexctl.errors import RobotFaultError
from hexctl.robot.servos.servo_schema import ServosSection
from hexctl.simulators.pca9685_board import Pca9685Board
from hexctl.simulators.servo2040_board import Servo2040Board
from hexctl.testing.family_conformance import running
from tests.backends.bus.boards import MemoryDevice, faults_of
from tests.backends.fake_time import FakeTime, Standing
from tests.robots import shipped


def a_map(driver: str = "servo2040", **section: Any) -> PwmMap:
    """Servos of the robot ant, whose horns are mounted so that its stance fits into their travel."""
    mounted = {"tibia": {"offset_deg": 40}, **section}
    return pwm_map_of(ServosSection.model_validate(mounted), driver)


@contextmanager
def pca9685_board(
    *faults: str, servos: LegServos | None = None, pwm_map: PwmMap | None = None, baud: int | None = None
) -> Iterator[Pca9685Board]:
    """Boards PCA9685 that run meanwhile, of a mock robot unless other servos are given."""
    board = Pca9685Board(
        servos or MockServos(shipped()),
        pwm_map or a_map("pca9685"),
        baud=baud,
        faults=faults_of(Pca9685Board, faults),
    )
    with running(board):
        yield board


@contextmanager
def memory_board(
    pwm_map: PwmMap, *faults: str, servos: LegServos | None = None, **options: Any
) -> Iterator[MemoryDevice[Any]]:
    """A board in memory, found at its path meanwhile; clocks that nobody gave are on its time.

    It moves a mock robot unless other servos are given; `options` are its model and baud.
    """
    time = FakeTime()
    moved = servos or MockServos(shipped(), clock=WallClock(time=Standing(time)))
    kind = resolve_name(find_board(pwm_map.driver).simulated)
    device = MemoryDevice(kind(moved, pwm_map, faults=faults_of(kind, faults), **options), time)
    with (
        patch("hexctl.backends.pwm.serial_board.SerialLine", device.open),
        patch("hexctl.backends.ticked_servos.WallClock", device.time.clock),
    ):
        yield device


def memory_servo2040(
    *faults: str, firmware: str = "stock", servos: LegServos | None = None, pwm_map: PwmMap | None = None
) -> AbstractContextManager[MemoryDevice[Servo2040Board]]:
    """A servo2040 in memory."""
    return memory_board(pwm_map or a_map(), *faults, model=firmware, servos=servos)


def servos_on(board: MemoryDevice[Any], pwm_map: PwmMap | None = None) -> Any:
    """Servos of the controller's end, not connected, by the map of the board unless another is given."""
    used = pwm_map or board.board._map
    make = find_board(used.driver).servos
    return make(shipped(), pwm_map=used, port=board.path, clock=board.time.clock())


def loses_poses(device: MemoryDevice[Any], share: float = 0.2) -> None:
    """Let poses of 30 bytes or more get lost on their way to a board, at random."""
    receive, rng = device.receive, random.Random(1)

    def lossy(timeout_s: float) -> bytes:
        data = receive(timeout_s)
        return b"" if len(data) >= 30 and rng.random() < share else data

    device.receive = lossy  # type: ignore[method-assign]


def nonsense_answers(kind: type[PwmServos], pwm_map: PwmMap, noise: bytes) -> bytes:
    """What servos ask of a device that has sent noise, at which they must find no board."""
    master, slave = os.openpty()
    tty.setraw(slave)
    try:
        os.write(master, noise)
        with pytest.raises(RobotFaultError, match=r"no .* answers"):
            kind(shipped(), pwm_map=pwm_map, port=os.ttyname(slave)).connect()
        return os.read(master, 1000)
    finally:
        os.close(master)
        os.close(slave)


def i2c_servos_on(board: Pca9685Board) -> Pca9685Servos:
    """Servos of the controller's end, not connected."""
    return Pca9685Servos(shipped(), pwm_map=a_map("pca9685"), port=board.path)
