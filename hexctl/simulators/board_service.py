"""A service that simulates a board or a bus of servos until it is stopped, without output or signals."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hexctl.backends.base import LegServos
from hexctl.backends.clock import request_realtime_priority
from hexctl.backends.registry import BackendOptions, make_servos
from hexctl.errors import InputError, argument
from hexctl.robot.servos.bus_map import bus_map_of
from hexctl.robot.servos.pwm_map import pwm_map_of
from hexctl.server.service import ServiceStarted
from hexctl.simulators.board_options import BoardOptions

if TYPE_CHECKING:
    from hexctl.backends.mavlink.mavlink_transport import Port
    from hexctl.simulators.board_faults import BoardFault
    from hexctl.simulators.servo_board import ServoBoard
    from hexctl.simulators.simulated_board import SimulatedBoard


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardService(BoardOptions):
    """Checked options of a simulated robot behind a MAVLink board, a bus, or PWM boards."""

    def __post_init__(self) -> None:
        super(BoardService, self).__post_init__()
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
        """Run until `stop_requested` returns True; the result is its counts, as JSON values.

        Raises InputError for an invalid port, robot, world, model or fault, RobotFaultError when
        the port cannot be opened or fails.
        """
        options = self.backend_options()
        servos = make_servos(self.backend, options)
        make: dict[str, Callable[..., tuple[ServoBoard | SimulatedBoard, str]]] = {
            "None": self._mavlink,
            "servo2040": self._servo2040,
            "pca9685": self._pca9685,
        }
        board, place = make.get(str(self.bus), self._bus)(servos, options)
        started = ServiceStarted(robot=servos.robot.name, backend=self.backend, place=place)

        def ready() -> None:  # real-time priority, now that what takes long is done
            on_started(replace(started, realtime=request_realtime_priority()))

        board.run(stop_requested, ready=ready)
        return board.report()

    def _mavlink(self, servos: LegServos, options: BackendOptions) -> "tuple[ServoBoard, str]":
        from hexctl.backends.mavlink.codec import read_signing_key
        from hexctl.simulators.servo_board import ServoBoard

        signing_key = read_signing_key(None if self.credentials is None else Path(self.credentials))
        port, place = self._opened_port()
        board = ServoBoard(
            servos,
            options.servo_map,
            port,
            signing_key=signing_key,
            expiry_s=self.expiry_s,
            release_after_s=self.release_after_s,
        )
        return board, place

    def _opened_port(self) -> "tuple[Port, str]":
        from hexctl.backends.mavlink import mavlink_transport as transport
        from hexctl.simulators.simulated_board import PseudoTerminal

        if self.pty:
            terminal = PseudoTerminal()
            return transport.StreamPort(terminal.descriptor, terminal.close), terminal.path
        text = self.connect or transport.DEFAULT_BOARD_PORT
        address, option = transport.parse_port(text), argument("connect")
        transport.check_guarded(address, option=option, text=text, signed=self.signed, insecure=self.insecure)
        return transport.open_port(address, text=text), text

    def _bus(self, servos: LegServos, options: BackendOptions) -> "tuple[SimulatedBoard, str]":
        from hexctl.simulators.bus_board import BusBoard

        section = options.servos_section
        if self.model is not None:
            section = section.model_copy(update={"model": self.model})
        bus_map, faults = bus_map_of(section, str(self.bus)), self._faults(BusBoard)
        board = BusBoard(servos, bus_map, baud=self.bits_per_s, faults=faults, seed=self.seed)
        return board, board.path

    def _servo2040(self, servos: LegServos, options: BackendOptions) -> "tuple[SimulatedBoard, str]":
        from hexctl.simulators.servo2040_board import Servo2040Board

        pwm_map, faults = pwm_map_of(options.servos_section, "servo2040"), self._faults(Servo2040Board)
        firmware = self.model or "stock"
        board = Servo2040Board(servos, pwm_map, firmware=firmware, faults=faults, seed=self.seed)
        return board, board.path

    def _pca9685(self, servos: LegServos, options: BackendOptions) -> "tuple[SimulatedBoard, str]":
        from hexctl.simulators.pca9685_board import Pca9685Board

        if self.model is not None:
            raise InputError(f"{argument('model')}: got {self.model} with pca9685; allowed: without")
        pwm_map, faults = pwm_map_of(options.servos_section, "pca9685"), self._faults(Pca9685Board)
        board = Pca9685Board(servos, pwm_map, bits_per_s=self.bits_per_s, faults=faults, seed=self.seed)
        return board, board.path

    def _faults(self, board: "type[SimulatedBoard]") -> "tuple[BoardFault, ...]":
        from hexctl.simulators.board_faults import parse_fault

        return tuple(parse_fault(text, board.kinds) for text in self.fault)
