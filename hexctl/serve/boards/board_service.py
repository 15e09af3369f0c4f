"""Services that are boards or buses of servos until they are told to stop.

Nothing here prints or handles signals: callers pass callbacks.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from hexctl.backends.base import LegServos
from hexctl.backends.clock import request_realtime_priority
from hexctl.backends.registry import make_servos
from hexctl.errors import InputError, argument
from hexctl.options import check_used
from hexctl.robot.schema import ServosSection
from hexctl.robot.servos.bus_map import bus_map_of
from hexctl.robot.servos.drivers import Driver
from hexctl.robot.servos.pwm_map import pwm_map_of
from hexctl.serve.boards.board_options import OF_BOARD, OF_BUS, BoardOptions
from hexctl.serve.service import ServiceStarted

if TYPE_CHECKING:
    from hexctl.backends.mavlink.mavlink_transport import Port, PortAddress
    from hexctl.serve.boards.board_faults import BoardFault
    from hexctl.serve.boards.simulated_board import SimulatedBoard


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardService(BoardOptions):
    """A MAVLink servo board with a simulated robot: options of a `ServoBoard`, checked when given."""

    def __post_init__(self) -> None:
        super(BoardService, self).__post_init__()
        check_used(self, OF_BUS, "with --bus")
        if self.pty and self.connect is not None:
            raise InputError(
                f"{argument('pty')}: got {argument('connect')} {self.connect} too; allowed: one or the other"
            )

    def run(
        self,
        stop_requested: Callable[[], bool],
        *,
        on_started: Callable[[ServiceStarted], None] = lambda _: None,
    ) -> dict[str, Any]:
        """Be a board until `stop_requested` returns True; the counts of its work, as JSON values.

        Raises InputError for a port, robot or world that is not allowed, RobotFaultError when the port cannot
        be opened or fails.
        """
        from hexctl.backends.mavlink.codec import read_signing_key
        from hexctl.serve.boards.servo_board import ServoBoard

        address = self._check_port()
        signing_key = read_signing_key(None if self.credentials is None else Path(self.credentials))
        options = self.backend_options()
        servo_map = options.servo_map
        servos = make_servos(self.backend, options)
        port, place = self._open_port(address)
        board = ServoBoard(
            servos,
            servo_map,
            port,
            signing_key=signing_key,
            expiry_s=self.expiry_s,
            release_after_s=self.release_after_s,
        )
        started = ServiceStarted(robot=servos.robot.name, backend=self.backend, place=place)
        board.run(stop_requested, ready=lambda: _start(started, on_started))
        return board.report()

    def _check_port(self) -> "PortAddress | None":
        from hexctl.backends.mavlink.mavlink_transport import DEFAULT_BOARD_PORT, check_guarded, parse_port

        if self.pty:
            return None
        text = self.connect or DEFAULT_BOARD_PORT
        address = parse_port(text)
        check_guarded(
            address, option=argument("connect"), text=text, signed=self.signed, insecure=self.insecure
        )
        return address

    def _open_port(self, address: "PortAddress | None") -> "tuple[Port, str]":
        from hexctl.backends.mavlink.mavlink_transport import DEFAULT_BOARD_PORT, StreamPort, open_port
        from hexctl.serve.boards.simulated_board import PseudoTerminal

        if address is None:
            terminal = PseudoTerminal()
            return StreamPort(terminal.descriptor, terminal.close), terminal.path
        text = self.connect or DEFAULT_BOARD_PORT
        return open_port(address, text=text), text


@dataclass(frozen=True, slots=True, kw_only=True)
class BusBoardService(BoardOptions):
    """Servos on a simulated bus, or boards: options of a `BusBoard`, checked when they are given."""

    def __post_init__(self) -> None:
        super(BusBoardService, self).__post_init__()
        if self.bus is None:
            raise InputError(f"{argument('bus')}: got none; allowed: {', '.join(get_args(Driver))}")
        check_used(self, OF_BOARD, "without --bus")

    def run(
        self,
        stop_requested: Callable[[], bool],
        *,
        on_started: Callable[[ServiceStarted], None] = lambda _: None,
    ) -> dict[str, Any]:
        """Be a bus until `stop_requested` returns True; the counts of its work, as JSON values.

        Raises InputError for a robot, world, model or fault that is not allowed.
        """
        options = self.backend_options()
        servos = make_servos(self.backend, options)
        make = {"servo2040": self._servo2040, "pca9685": self._pca9685}.get(str(self.bus), self._bus)
        board = make(servos, options.servos_section)
        started = ServiceStarted(robot=servos.robot.name, backend=self.backend, place=board.path)
        board.run(stop_requested, ready=lambda: _start(started, on_started))
        return board.report()

    def _bus(self, servos: LegServos, section: ServosSection) -> "SimulatedBoard":
        from hexctl.serve.boards.bus_board import BusBoard

        if self.model is not None:
            section = section.model_copy(update={"model": self.model})
        bus_map = bus_map_of(section, str(self.bus))
        faults = self._faults(BusBoard)
        return BusBoard(servos, bus_map, baud=self.bits_per_s, faults=faults, seed=self.seed)

    def _servo2040(self, servos: LegServos, section: ServosSection) -> "SimulatedBoard":
        from hexctl.serve.boards.servo2040_board import Servo2040Board

        pwm_map, firmware = pwm_map_of(section, str(self.bus)), self.model or "stock"
        faults = self._faults(Servo2040Board)
        return Servo2040Board(servos, pwm_map, firmware=firmware, faults=faults, seed=self.seed)

    def _pca9685(self, servos: LegServos, section: ServosSection) -> "SimulatedBoard":
        from hexctl.serve.boards.pca9685_board import Pca9685Board

        if self.model is not None:
            raise InputError(f"{argument('model')}: got {self.model} with pca9685; allowed: without")
        pwm_map, faults = pwm_map_of(section, str(self.bus)), self._faults(Pca9685Board)
        return Pca9685Board(servos, pwm_map, bits_per_s=self.bits_per_s, faults=faults, seed=self.seed)

    def _faults(self, board: "type[SimulatedBoard]") -> "tuple[BoardFault, ...]":
        from hexctl.serve.boards.board_faults import parse_fault

        return tuple(parse_fault(text, board.kinds) for text in self.fault)


def _start(started: ServiceStarted, on_started: Callable[[ServiceStarted], None]) -> None:
    """Take real-time priority, now that what takes long is done, and say that the board is there."""
    on_started(replace(started, realtime=request_realtime_priority()))
