"""A board or bus with a twin on it: `python -m faults.programs.twin_board BACKEND ROBOT FOLDER`.

BACKEND is mavlink or a bus. Prints where it is reached. Words that are not the twin's are faults of the bus,
such as `mute:2:femur`, or `loss 0.1` of its line.
"""

import math
import random
import signal
import socket
import sys
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import numpy as np

from faults.process import free_port
from faults.programs.truth import TOLD
from faults.programs.twin import TwinServos
from hexctl.backends.bus.bus_map import bus_map_of
from hexctl.backends.clock import PERIOD_S, realtime_priority
from hexctl.backends.mavlink.mavlink_transport import open_port, parse_port
from hexctl.backends.pwm.pulse_board import find_board, pwm_map_of
from hexctl.robot.loader import load_robot_file
from hexctl.robot.servos.drivers import bus_drivers
from hexctl.simulators.board_faults import parse_fault
from hexctl.simulators.bus_board import BusBoard
from hexctl.simulators.lx16a_servos import SimulatedLx16aServo
from hexctl.simulators.servo_board import ServoBoard
from hexctl.simulators.simulated_board import PseudoTerminal, SimulatedBoard


class LossyLine:
    """A serial line on which writes get lost, either way.

    Args:
        line: the line itself.
        seed: of what is lost.

    Attributes:
        loss: share that is lost.
        path: of the line.
    """

    def __init__(self, line: PseudoTerminal, seed: int) -> None:
        self._line, self.loss, self.path = line, 0.0, line.path
        self._random = random.Random(seed)

    @property
    def speed(self) -> int:
        """Speed at which the controller has opened the line."""
        return self._line.speed

    def receive(self, timeout_s: float) -> bytes:
        """What comes within a time."""
        data = self._line.receive(timeout_s)
        return b"" if data and self._random.random() < self.loss else data

    def send(self, data: bytes) -> None:
        """Send."""
        if self._random.random() >= self.loss:
            self._line.send(data)


class Told(SimulatedBoard):
    """What a board of the matrix has besides: it notes what its servos steer for, and takes words.

    It does so when they are told something, and once in a control period for moves that take a time.
    """

    _line: Any

    def observe(self, twin: TwinServos) -> None:
        """Write into the truth of a twin, and take its words."""
        self._twin, self._goals, self._noted_s = twin, 0, -math.inf
        twin.others = self._fail
        if isinstance(self._line, PseudoTerminal):  # on which packets may get lost
            self._line = LossyLine(self._line, seed=1)

    def _serve(self, timeout_s: float) -> None:
        super()._serve(timeout_s)  # type: ignore[safe-super]  # behind it is a board
        goals, now_s = self.counts["goals"], time.monotonic()
        if goals == self._goals and (not self._moves_take_time() or now_s < self._noted_s + PERIOD_S):
            return
        self._goals, self._noted_s = goals, now_s
        holds, angles_rad = self._servo_targets()
        self._twin.truth.add(TOLD, np.where(holds, angles_rad, np.nan))

    def _moves_take_time(self) -> bool:
        return False

    def _fail(self, word: str) -> None:
        """Begin a fault, or another share of packets that get lost."""
        if not word.startswith("loss "):
            self.to_come.append(parse_fault(word, self.kinds))
        elif isinstance(self._line, LossyLine):
            self._line.loss = float(word.split()[1])
        else:
            raise ValueError(f"{word}: this board has no line that loses packets")


class ToldBus(Told, BusBoard):
    """Servos on a serial bus."""

    def _moves_take_time(self) -> bool:
        return isinstance(self._servos[0], SimulatedLx16aServo)


def made_board(backend: str, robot_file: Path, folder: Path) -> tuple[Any, str]:
    """Board of a backend with a twin, and where it is reached."""
    file = load_robot_file(robot_file)
    twin = TwinServos(file.robot, folder=folder, told=backend == "mavlink")
    section = file.content.servos
    if backend == "mavlink":
        number = free_port(socket.SOCK_DGRAM)
        text = f"udpin:127.0.0.1:{number}"
        board = ServoBoard(twin, file.servo_map, open_port(parse_port(text), text=text))
        return board, f"udpout:127.0.0.1:{number}"
    if backend in bus_drivers():
        bus_map = bus_map_of(section, backend)
        told: Told = ToldBus(twin, bus_map, baud=bus_map.family.bauds[0])
    else:
        board = resolve_name(find_board(backend).simulated)
        told = type(f"Told{board.__name__}", (Told, board), {})(twin, pwm_map_of(section, backend))
    told.observe(twin)
    return told, told.path


def main(backend: str, robot_file: str, folder: str) -> None:
    """Be a board until SIGTERM."""
    over = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: over.set())
    board, place = made_board(backend, Path(robot_file), Path(folder))
    with ExitStack() as priority:

        def ready() -> None:
            priority.enter_context(realtime_priority())
            print(f"board at {place}", flush=True)

        board.run(over.is_set, ready=ready)


if __name__ == "__main__":
    main(*sys.argv[1:])
