"""Servos on a simulated bus, in a thread of the test."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from hexctl.backends.base import LegServos
from hexctl.backends.bus.servos import BusServos
from hexctl.backends.mock import MockServos
from hexctl.robot.schema import ServosSection
from hexctl.robot.servos.bus_map import BusMap, bus_map_of
from hexctl.robot.servos.servo_models import DEFAULT_BAUDS
from hexctl.simulators.board_faults import parse_fault
from hexctl.simulators.bus_board import BusBoard
from tests.robots import shipped

#: Models of every kind of registers.
MODELS = (
    ("dynamixel", "ax12a"),
    ("dynamixel", "xl320"),
    ("dynamixel", "xl330-m288"),
    ("dynamixel", "xl430-w250"),
    ("feetech", "sts3215"),
    ("feetech", "scs0009"),
)


def a_map(driver: str = "feetech", model: str = "sts3215") -> BusMap:
    """Servos of one model, ids 1 to 18, whose horns are mounted so that the stance fits into their travel."""
    section = ServosSection.model_validate(
        {"model": model, "femur": {"offset_deg": -10, "sign": -1}, "tibia": {"offset_deg": 40}}
    )
    return bus_map_of(section, driver)


@contextmanager
def bus_board(
    bus_map: BusMap, *faults: str, servos: LegServos | None = None, baud: int | None = None
) -> Iterator[BusBoard]:
    """A bus that runs meanwhile, of servos without a robot unless others are given."""
    moved = MockServos(shipped("phantomx")) if servos is None else servos
    speed = baud or DEFAULT_BAUDS[bus_map.driver]
    given = tuple(parse_fault(fault, BusBoard.kinds) for fault in faults)
    board = BusBoard(moved, bus_map, baud=speed, faults=given)
    stop, ready = threading.Event(), threading.Event()
    thread = threading.Thread(target=board.run, args=(stop.is_set,), kwargs={"ready": ready.set})
    thread.start()
    try:
        assert ready.wait(20)
        yield board
    finally:
        stop.set()
        thread.join()


def servos_on(board: BusBoard, bus_map: BusMap) -> BusServos:
    """Servos of the controller's end, not connected."""
    return BusServos(shipped("phantomx"), bus_map=bus_map, port=board.path)


def stance_counts(bus_map: BusMap) -> "np.ndarray[tuple[int], np.dtype[np.float64]]":
    """Counts of the stance, rounded."""
    return np.rint(bus_map.raw(shipped("phantomx").stance_angles_rad))
