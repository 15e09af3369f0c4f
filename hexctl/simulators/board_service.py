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
        make = self._mavlink if self.bus is None else self._simulated
        board, place = make(servos, options)
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

    def _simulated(self, servos: LegServos, options: BackendOptions) -> "tuple[SimulatedBoard, str]":
        from hexctl.simulators.bus_board import BusBoard
        from hexctl.simulators.pca9685_board import Pca9685Board
        from hexctl.simulators.servo2040_board import Servo2040Board

        driver, section, firmware = str(self.bus), options.servos_section, self.model or "stock"
        board: SimulatedBoard
        if driver == "servo2040":
            more = self._faults(Servo2040Board)
            board = Servo2040Board(servos, pwm_map_of(section, driver), firmware=firmware, **more)
        elif driver == "pca9685":
            more = self._faults(Pca9685Board)
            board = Pca9685Board(servos, pwm_map_of(section, driver), bits_per_s=self.bits_per_s, **more)
        else:
            given = {} if self.model is None else {"model": self.model}
            bus_map, more = bus_map_of(section.model_copy(update=given), driver), self._faults(BusBoard)
            board = BusBoard(servos, bus_map, baud=self.bits_per_s, **more)
        return board, board.path

    def _faults(self, board: "type[SimulatedBoard]") -> dict[str, Any]:
        from hexctl.simulators.board_faults import parse_fault

        return {"faults": tuple(parse_fault(text, board.kinds) for text in self.fault), "seed": self.seed}
