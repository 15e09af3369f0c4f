"""Lines in memory, on simulated time: nothing waits, and no pseudo-terminal is between both ends."""

from collections.abc import Callable

from hexctl.backends.bus.packets import PacketFormat
from hexctl.backends.bus.serial_line import SerialLine
from hexctl.backends.mock import MockServos
from hexctl.robot.servos.bus_map import BusMap
from hexctl.robot.servos.servo_models import DEFAULT_BAUDS
from hexctl.simulators.board_faults import parse_fault
from hexctl.simulators.bus_board import BusBoard
from tests.backends.fake_time import FakeTime
from tests.robots import shipped


class MemoryLine(SerialLine):
    """A line whose other end is in this thread.

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


class LateServoLine(MemoryLine):
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
        super().__init__(FakeTime(), baud)
        self._packets, self._answered = packets, answer
        self.delays_s: list[float] = []

    def _put(self, data: bytes, deadline_s: float) -> None:
        packet, _ = self._packets.take(data)
        assert packet is not None
        delay_s = self.delays_s.pop(0) if self.delays_s else 0.0
        answer = self._packets.status(packet[0], *self._answered(packet[1], packet[2]))
        self.coming.append((self.time.now() + delay_s, answer))


class BoardLine(MemoryLine):
    """A line with a simulated bus, whose servos move a mock robot.

    Attributes:
        board: the bus.
    """

    def __init__(self, bus_map: BusMap, *faults: str) -> None:
        baud, time = DEFAULT_BAUDS[bus_map.driver], FakeTime()
        super().__init__(time, baud)
        given = tuple(parse_fault(fault, BusBoard.kinds) for fault in faults)
        self.robot = MockServos(shipped("phantomx"), clock=time.clock())
        self.board = BusBoard(self.robot, bus_map, baud=baud, faults=given)
        self.board._line.close()
        self.board._line, self._sent = self, b""  # type: ignore[assignment]
        self.robot.connect()
        self.robot.clock.tick()
        self.board._start()

    @property
    def speed(self) -> int:
        """Speed as a terminal has it: none that it knows."""
        return -1

    def receive(self, timeout_s: float) -> bytes:
        """Bytes for the board."""
        sent, self._sent = self._sent, b""
        return sent

    def send(self, data: bytes) -> None:
        """Bytes from the board."""
        self.coming.append((self.time.now(), data))

    def pass_time(self, duration_s: float) -> None:
        """Let a time pass, in s, in which the board has its control periods."""
        until_s = self.time.now() + duration_s
        while self.robot.clock.due_in_s <= until_s - self.time.now():
            self.robot.clock.tick()
            self.board._tick()
        self.time.sleep(max(0.0, until_s - self.time.now()))

    def _put(self, data: bytes, deadline_s: float) -> None:
        self._sent += data
        self.board._serve(0.0)  # answers are sent once the line has carried them
        self.pass_time(0.0)
