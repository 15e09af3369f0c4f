"""Tests for every family of bus servos, on its simulated bus."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TypeVar

import pytest

from hexctl.backends.base import LegServos
from hexctl.backends.bus.bus_map import bus_map_of
from hexctl.backends.bus.servos import BusServos
from hexctl.backends.bus.tools import scan_bus
from hexctl.backends.mock import MockServos
from hexctl.robot.servos.servo_schema import ServosSection
from hexctl.simulators.bus_board import BusBoard
from hexctl.simulators.simulated_board import SimulatedBoard
from hexctl.testing.servo_conformance import LegServosConformance

Board = TypeVar("Board", bound=SimulatedBoard)

#: How the horns are mounted, so that the stance fits into the travel of most servos.
MOUNTED = {"femur": {"offset_deg": -10, "sign": -1}, "tibia": {"offset_deg": 40}}

#: Time for a simulated board to start.
STARTS_S = 20.0


@contextmanager
def running(board: Board) -> Iterator[Board]:
    """A simulated board that runs meanwhile, in a thread."""
    stop, ready = threading.Event(), threading.Event()
    thread = threading.Thread(target=board.run, args=(stop.is_set,), kwargs={"ready": ready.set})
    thread.start()
    try:
        assert ready.wait(STARTS_S)
        yield board
    finally:
        stop.set()
        thread.join()


class BusFamilyConformance(LegServosConformance):
    """The suite for a family: inherit it, name the class `Test...` and set `driver`.

    Attributes:
        driver: name of the family, by which it is also found among plug-ins.
        model: of all servos; None for the default.
    """

    driver: str
    model: str | None = None

    @pytest.fixture(autouse=True)
    def board(self) -> Iterator[BusBoard]:
        """A simulated bus in real time."""
        self._map = bus_map_of(ServosSection.model_validate({"model": self.model, **MOUNTED}), self.driver)
        board = BusBoard(MockServos("phantomx"), self._map, baud=self._map.family.bauds[0])
        with running(board) as self._board:
            yield board

    def make(self) -> LegServos:
        """Servos on the simulated bus."""
        return BusServos("phantomx", bus_map=self._map, port=self._board.path)

    def test_a_scan_finds_the_servos(self) -> None:
        """A scan finds the servos and their positions."""
        found = scan_bus(self._board.path, self.driver, self._map.family.bauds[0], ids=range(1, 4))
        assert [each.servo_id for each in found] == [1, 2, 3]
        assert all(each.position is not None for each in found)
