"""Boards of hobby servos at a serial device."""

from abc import abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

from hexctl.backends.bus.serial_line import SerialLine
from hexctl.backends.clock import PERIOD_S, Clock
from hexctl.backends.pwm.pwm_map import PwmMap
from hexctl.backends.pwm.servos import PwmBoard, PwmServos
from hexctl.backends.serial_ports import SerialAddress
from hexctl.errors import InputError, argument
from hexctl.robot.model import Robot

#: Share of a control period that a pose may take on the wire; questions and answers need the rest.
POSE_SHARE = 0.8

#: Speeds that boards have.
BAUDS = (9600, 19_200, 38_400, 57_600, 115_200, 230_400)


class SerialPwmServos(PwmServos):
    """Eighteen hobby servos on a board at a serial device; `port` may name its speed: `/dev/ttyUSB0:38400`.

    Raises InputError for a speed at which a pose takes too long.
    """

    #: Speed of a port without one.
    usual_baud: ClassVar[int]

    def __init__(
        self, robot: Robot | str | Path, *, pwm_map: PwmMap, port: str, clock: Clock | None = None
    ) -> None:
        super().__init__(robot, pwm_map=pwm_map, port=port, clock=clock)
        address = SerialAddress.parse(port, self.usual_baud)
        self._path, self._baud = address.path, address.baud
        count = self._pose_bytes()
        if not fits(count, self._baud):
            raise InputError(f"{argument('port')}: got {too_slow(count, self._baud)}")

    @abstractmethod
    def _board(self, line: SerialLine) -> PwmBoard:
        """The board on an open line; raises RobotFaultError or OSError if there is none."""

    def _pose_bytes(self) -> int:
        """Number of bytes of a pose, for a line whose speed matters."""
        return 0

    def _open(self) -> PwmBoard:
        line = SerialLine(self._path, self._baud, time=self._clock.time)
        try:
            return self._board(line)
        except BaseException:
            line.close()
            raise


def fits(count: int, baud: int) -> bool:
    """Whether a pose of some bytes can be sent in every control period."""
    return 10 * count / baud <= POSE_SHARE * PERIOD_S


def too_slow(count: int, baud: int) -> str:
    """Message about a pose that takes too long on the wire, for an error."""
    least = next((each for each in BAUDS if fits(count, each)), BAUDS[-1])
    return (
        f"{baud} baud, at which a pose of {count} bytes takes {1e4 * count / baud:.0f} of "
        f"{1e3 * PERIOD_S:.0f} ms; allowed: {least} baud or more, set in the board too"
    )


def gather(line: SerialLine, count: int, wait_s: float) -> bytes:
    """Bytes of an answer; fewer if they do not come within `wait_s` and their time on the wire."""
    deadline_s, data = line.time.now() + wait_s + line.wire_s(count), b""
    while len(data) < count and (more := line.read(deadline_s)):
        data += more
    return data


def serial_port_parser(what: str, usual_baud: int) -> Callable[[str | None, int | None], str]:
    """Parser of a port as `PulseBoard` has it: the device that `what` describes, with its speed."""
    allowed = f"{what}, here or as `port` in the section `servos` of the robot file"

    def parse(text: str | None, baud: int | None = None) -> str:
        address = SerialAddress.parse(text, baud or usual_baud, allowed=allowed)
        return f"{address.path}:{address.baud}"

    return parse
