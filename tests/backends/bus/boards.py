"""Servos on a simulated bus: on a pseudo-terminal in a thread of the test, or in memory on simulated time."""

import termios
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Generic, TypeVar
from unittest.mock import patch

import numpy as np

from hexctl.backends.base import LegServos
from hexctl.backends.bus.bus_map import BusMap, bus_map_of
from hexctl.backends.bus.family import find_family
from hexctl.backends.bus.packets import PacketFormat
from hexctl.backends.bus.serial_line import SerialLine
from hexctl.backends.bus.servos import BusServos
from hexctl.backends.clock import PERIOD_S, WallClock
from hexctl.backends.mock import MockServos
from hexctl.errors import RobotFaultError
from hexctl.robot.servos.drivers import FAMILIES as DRIVERS
from hexctl.robot.servos.servo_schema import ServosSection
from hexctl.simulators.board_faults import BoardFault, parse_fault
from hexctl.simulators.bus_board import BusBoard
from hexctl.simulators.register_servos import BusServo
from hexctl.simulators.simulated_board import SimulatedBoard
from hexctl.testing.family_conformance import running
from hexctl.time_source import TimeSource
from hexctl.types import JOINT_NAMES
from tests.backends.fake_time import FakeTime, Standing
from tests.robots import shipped

Board = TypeVar("Board", bound=SimulatedBoard)

#: All models that hexctl has, by name.
MODELS_BY_NAME = {model.name: model for driver in DRIVERS for model in find_family(driver).models}

#: Models of every kind of registers.
MODELS = (
    ("dynamixel", "ax12a"),
    ("dynamixel", "xl320"),
    ("dynamixel", "xl330-m288"),
    ("dynamixel", "xl430-w250"),
    ("feetech", "sts3215"),
    ("feetech", "scs0009"),
)

#: One model of each protocol.
FAMILIES = (("dynamixel", "ax12a"), ("dynamixel", "xl430-w250"), ("feetech", "sts3215"), ("lx16a", "lx16a"))


def a_map(driver: str = "feetech", model: str = "sts3215", *, first_id: int = 1) -> BusMap:
    """Servos of one model whose horns are mounted so that the stance fits into their travel."""
    joints = {name: {"id": first_id + place} for place, name in enumerate(JOINT_NAMES)}
    mounted = {"femur": {"offset_deg": -10, "sign": -1}, "tibia": {"offset_deg": 40}}
    return bus_map_of(ServosSection.model_validate({"model": model, **mounted, **joints}), driver)


def stance_counts(bus_map: BusMap) -> "np.ndarray[tuple[int], np.dtype[np.float64]]":
    """Counts of the stance, rounded."""
    return np.rint(bus_map.raw(shipped("phantomx").stance_angles_rad))


def faults_of(kind: type[SimulatedBoard], texts: tuple[str, ...]) -> tuple[BoardFault, ...]:
    """Faults of a kind of board by their words."""
    return tuple(parse_fault(text, kind.kinds) for text in texts)


def _board(bus_map: BusMap, faults: tuple[str, ...], servos: LegServos, baud: int | None = None) -> BusBoard:
    baud = baud or bus_map.family.bauds[0]
    return BusBoard(servos, bus_map, baud=baud, faults=faults_of(BusBoard, faults))


@contextmanager
def bus_board(
    bus_map: BusMap, *faults: str, servos: LegServos | None = None, baud: int | None = None
) -> Iterator[BusBoard]:
    """A bus on a pseudo-terminal, of servos without a robot unless others are given."""
    board = _board(bus_map, faults, MockServos(shipped("phantomx")) if servos is None else servos, baud)
    with running(board):
        yield board


def register_servo_of(board: BusBoard, joint: int) -> BusServo:
    """The simulated servo of a joint, which has registers."""
    servo = board._servos[joint]
    assert isinstance(servo, BusServo)
    return servo


class MemoryLine(SerialLine):
    """A line whose other end is in this process, on simulated time.

    Attributes:
        coming: times and bytes of what is on its way to this end.
    """

    def __init__(self, time: FakeTime, baud: int = 1_000_000) -> None:
        self.path, self.baud, self.time = "memory", baud, time
        self.echoes, self.free_s, self._echo, self._last, self._damaged = False, 0.0, b"", b"", None
        self.coming: list[tuple[float, bytes]] = []

    def close(self) -> None:
        """Nothing is open."""

    def pass_time(self, duration_s: float) -> None:
        """Let a time pass, in s, and the other end do what is due meanwhile."""
        self.time.sleep(duration_s)

    def _put(self, data: bytes, deadline_s: float) -> None:
        raise NotImplementedError

    def _take(self, wait_s: float) -> bytes:
        until_s = self.time.now() + wait_s
        while not (due := [each for each in self.coming if each[0] <= self.time.now()]):
            now_s = self.time.now()
            if now_s >= until_s:
                return b""
            self.pass_time(min([until_s, *(at_s for at_s, _ in self.coming)]) - now_s)
        self.coming = [each for each in self.coming if each not in due]
        return b"".join(data for _, data in due)


class AnsweringLine(MemoryLine):
    """A line on which a function answers what is sent; it returns delays and bytes."""

    def __init__(self, answers: Callable[[bytes], list[tuple[float, bytes]]], baud: int = 1_000_000) -> None:
        super().__init__(FakeTime(), baud)
        self._answers = answers

    def _put(self, data: bytes, deadline_s: float) -> None:
        self.coming += [(self.time.now() + delay_s, answer) for delay_s, answer in self._answers(data)]


class LateServoLine(AnsweringLine):
    """A line with a servo that answers single questions, each after a delay that a test sets; else at once.

    Args:
        packets: format of its packets.
        answer: error and parameters of the answer to an instruction and its parameters.

    Attributes:
        delays_s: of the next answers.
    """

    def __init__(
        self, packets: PacketFormat, answer: Callable[[int, bytes], tuple[int, bytes]], baud: int = 1_000_000
    ) -> None:
        super().__init__(self._late, baud)
        self._packets, self._answered = packets, answer
        self.delays_s: list[float] = []

    def _late(self, data: bytes) -> list[tuple[float, bytes]]:
        packet, _ = self._packets.take(data)
        assert packet is not None
        delay_s = self.delays_s.pop(0) if self.delays_s else 0.0
        return [(delay_s, self._packets.status(packet[0], *self._answered(packet[1], packet[2])))]


class MemoryDevice(Generic[Board]):
    """A simulated board in the place of a port: any thread may open it, and no one waits for it.

    Its control periods pass when somebody speaks to it.

    Attributes:
        board: the board.
        time: of everything on it; it passes while the test's own thread waits.
        path: where it is.
        unplugged: whether the device has gone.
    """

    def __init__(self, board: Board, time: FakeTime) -> None:
        self.time, self.path, self.unplugged, self.opened_baud = time, board.path, False, 0
        self.board, self._clock = board, board._robot.clock
        self._ticked_s = time.now() - PERIOD_S
        self._sent, self._answers = b"", b""
        board._line.close()  # type: ignore[attr-defined]
        board._line = self  # type: ignore[attr-defined]
        board._robot.connect()
        if isinstance(self._clock, WallClock):
            self._clock.begin(self._ticked_s)
        board._start()

    def open(
        self, path: str, baud: int, *, modem_lines: bool = True, time: TimeSource | None = None
    ) -> SerialLine:
        """Open the line, as `SerialLine` does."""
        if self.unplugged or path != self.path:
            raise RobotFaultError(f"there is no port {path}")
        self.opened_baud, self._sent, self._answers = baud, b"", b""
        return _MemoryDeviceLine(self, baud)

    def speak(self, data: bytes) -> bytes:
        """What the board answers to some bytes."""
        if self.time.now() - self._ticked_s >= PERIOD_S:
            self._ticked_s = self.time.now()
            self._clock.tick()
            self.board._tick()
        self._sent += data
        self.board._serve(0.0)
        answers, self._answers = self._answers, b""
        return answers

    @property
    def speed(self) -> int:
        """Speed as a terminal has it."""
        return int(getattr(termios, f"B{self.opened_baud}"))

    def receive(self, timeout_s: float) -> bytes:
        """Bytes for the board."""
        sent, self._sent = self._sent, b""
        return sent

    def send(self, data: bytes) -> None:
        """Bytes from the board."""
        self._answers += data


class MemoryBus(MemoryDevice[BusBoard]):
    """A simulated bus in memory, whose servos move `robot`, a mock."""

    def __init__(
        self,
        bus_map: BusMap,
        *faults: str,
        baud: int | None = None,
        kind: type[MockServos] = MockServos,
        waits: bool = False,
    ) -> None:
        time = FakeTime()
        self.robot = kind(shipped("phantomx"), clock=WallClock(time=time if waits else Standing(time)))
        super().__init__(_board(bus_map, faults, self.robot, baud), time)


class _MemoryDeviceLine(MemoryLine):
    def __init__(self, device: MemoryDevice[Any], baud: int) -> None:
        super().__init__(device.time, baud)
        self._end, self.path = device, device.path

    def _put(self, data: bytes, deadline_s: float) -> None:
        if self._end.unplugged:
            raise OSError(5, "Input/output error")
        if answers := self._end.speak(data):
            self.coming.append((self.time.now(), answers))

    def _take(self, wait_s: float) -> bytes:
        if self._end.unplugged:
            raise OSError(5, "Input/output error")
        return super()._take(wait_s)


class BoardLine(_MemoryDeviceLine):
    """A line of one thread with a simulated bus, whose servos take their time to answer.

    Attributes:
        board: the bus.
        robot: what its servos move, a MockServos unless another kind of it is given.
    """

    def __init__(self, bus_map: BusMap, *faults: str, kind: type[MockServos] = MockServos) -> None:
        bus = MemoryBus(bus_map, *faults, kind=kind, waits=True)
        super().__init__(bus, bus_map.family.bauds[0])
        self.board, self.robot = bus.board, bus.robot
        bus.opened_baud = self.baud

    def pass_time(self, duration_s: float) -> None:
        """Let a time pass, in s, in which the board has its control periods."""
        until_s = self.time.now() + duration_s
        while (left_s := until_s - self.time.now()) > 0:
            self.time.sleep(min(left_s, PERIOD_S))
            if answers := self._end.speak(b""):
                self.coming.append((self.time.now(), answers))


@contextmanager
def memory_bus(
    bus_map: BusMap, *faults: str, baud: int | None = None, kind: type[MockServos] = MockServos
) -> Iterator[MemoryBus]:
    """A bus in memory, which is found at its path meanwhile; clocks that nobody gave are on its time."""
    bus = MemoryBus(bus_map, *faults, baud=baud, kind=kind)
    with (
        patch("hexctl.backends.bus.servos.SerialLine", bus.open),
        patch("hexctl.backends.bus.tools.SerialLine", bus.open),
        patch("hexctl.backends.ticked_servos.WallClock", bus.time.clock),
        patch("hexctl.control.calibration.servo_trial.WallClock", bus.time.clock),
    ):
        yield bus


def servos_on(bus: MemoryBus | BusBoard, bus_map: BusMap) -> BusServos:
    """Servos of the controller's end, not connected."""
    clock = bus.time.clock() if isinstance(bus, MemoryBus) else None
    return BusServos(shipped("phantomx"), bus_map=bus_map, port=bus.path, clock=clock)


class SdkSerial:
    """The serial port of a vendor's SDK, in the place of pyserial's, on a line in memory."""

    def __init__(self, line: BoardLine) -> None:
        self._line, self._came = line, b""

    @property
    def in_waiting(self) -> int:
        """Count of bytes that have come."""
        self._came += self._line._take(0.0)
        return len(self._came)

    def write(self, packet: Any) -> int:
        """Send bytes, and let a little time pass."""
        self._line.write(bytes(packet))
        self._line.pass_time(0.005)
        return len(packet)

    def read(self, count: int) -> bytes:
        """Bytes that have come."""
        size = min(count, self.in_waiting)
        data, self._came = self._came[:size], self._came[size:]
        return data

    def reset_input_buffer(self) -> None:
        """Forget what has come."""
        self.read(self.in_waiting)

    flush = reset_input_buffer
    flushInput = reset_input_buffer  # noqa: N815  as pyserial has it

    def close(self) -> None:
        """Nothing is open."""


def sdk_port(handler: Any, line: BoardLine) -> Any:
    """An open port of a vendor's SDK on a line in memory."""
    port = handler("memory")
    port.ser, port.is_open, port.tx_time_per_byte = SdkSerial(line), True, 0.01
    return port
