"""Services that are boards or buses of servos until they are told to stop.

Nothing here prints or handles signals: callers pass callbacks.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hexctl.backends.base import LegServos
from hexctl.backends.clock import request_realtime_priority
from hexctl.backends.registry import make_servos
from hexctl.errors import InputError, argument
from hexctl.robot.schema import ServosSection
from hexctl.robot.servos.bus_map import bus_map_of
from hexctl.robot.servos.pwm_map import pwm_map_of
from hexctl.robot.servos.servo_models import DEFAULT_BAUDS
from hexctl.serve.service import ServiceStarted, ServosSpec, check_between

if TYPE_CHECKING:
    from hexctl.backends.mavlink.mavlink_transport import Port, PortAddress
    from hexctl.serve.boards.simulated_board import SimulatedBoard

MIN_EXPIRY_S, MAX_EXPIRY_S = 0.05, 1.0
MIN_RELEASE_S, MAX_RELEASE_S = 1.0, 3600.0
BOARD_BACKENDS = ("sim", "mock")


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardService:
    """A MAVLink servo board with a simulated robot: options of a `ServoBoard`, checked when they are given.

    Attributes:
        servos: what the board moves, `sim` or `mock`.
        port: MAVLink port; None is the default one.
        pty: make a pseudo-terminal instead of opening a port.
        expiry_s: seconds without a command until the pose is held.
        release_after_s: seconds without the controller until the torque is switched off.
        keys: folder with `mavlink.key`, or None: frames need not be signed.
        insecure: whether unsigned frames from beyond this computer are obeyed.
    """

    servos: ServosSpec = field(default_factory=ServosSpec)
    port: str | None = None
    pty: bool = False
    expiry_s: float = 0.2
    release_after_s: float = 10.0
    keys: Path | None = None
    insecure: bool = False

    def __post_init__(self) -> None:
        if self.servos.backend not in BOARD_BACKENDS:
            raise InputError(
                f"{argument('backend')}: got {self.servos.backend}; allowed: {', '.join(BOARD_BACKENDS)}"
            )
        self.servos.check()
        if self.pty and self.port is not None:
            raise InputError(
                f"{argument('pty')}: got {argument('port')} {self.port} too; allowed: one or the other"
            )
        check_between(argument("expiry_s"), self.expiry_s, MIN_EXPIRY_S, MAX_EXPIRY_S)
        check_between(argument("release_after_s"), self.release_after_s, MIN_RELEASE_S, MAX_RELEASE_S)

    @property
    def signed(self) -> bool:
        """Whether only signed frames are obeyed."""
        return self.keys is not None

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
        signing_key = read_signing_key(self.keys)
        options = self.servos.options()
        servo_map = options.servo_map
        servos = make_servos(self.servos.backend, options)
        port, place = self._open_port(address)
        board = ServoBoard(
            servos,
            servo_map,
            port,
            signing_key=signing_key,
            expiry_s=self.expiry_s,
            release_after_s=self.release_after_s,
        )
        started = ServiceStarted(robot=servos.robot.name, backend=self.servos.backend, place=place)
        board.run(stop_requested, ready=lambda: _start(started, on_started))
        return board.report()

    def _check_port(self) -> "PortAddress | None":
        """Address of the port, None for a pseudo-terminal."""
        from hexctl.backends.mavlink.mavlink_transport import DEFAULT_BOARD_PORT, check_guarded, parse_port

        if self.pty:
            return None
        text = self.port or DEFAULT_BOARD_PORT
        address = parse_port(text)
        check_guarded(address, option=argument("port"), text=text, signed=self.signed, insecure=self.insecure)
        return address

    def _open_port(self, address: "PortAddress | None") -> "tuple[Port, str]":
        """Opened port, and where controllers reach it."""
        from hexctl.backends.mavlink.mavlink_transport import DEFAULT_BOARD_PORT, PtyPort, open_port

        if address is None:
            terminal = PtyPort()
            return terminal, terminal.path
        text = self.port or DEFAULT_BOARD_PORT
        return open_port(address, text=text), text


@dataclass(frozen=True, slots=True, kw_only=True)
class BusBoardService:
    """Servos on a simulated bus: options of a `BusBoard`, checked when they are given.

    Attributes:
        driver: whose protocol they speak, of `BUS_DRIVERS`, or of `PWM_DRIVERS`, whose boards are simulated.
        servos: what they move, `sim` or `mock`.
        model: of all servos, in place of those of the robot file; of a servo2040 the firmware.
        baud: bits per second of the line; usual for the driver unless given.
        faults: what goes wrong, in the words of `parse_bus_fault`, or of the board's own function.
    """

    driver: str
    servos: ServosSpec = field(default_factory=ServosSpec)
    model: str | None = None
    baud: int | None = None
    faults: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.servos.backend not in BOARD_BACKENDS:
            raise InputError(
                f"{argument('backend')}: got {self.servos.backend}; allowed: {', '.join(BOARD_BACKENDS)}"
            )
        self.servos.check()

    @property
    def bits_per_s(self) -> int:
        """Speed of the line."""
        return self.baud or {"servo2040": 115_200, "pca9685": 400_000, **DEFAULT_BAUDS}[self.driver]

    def run(
        self,
        stop_requested: Callable[[], bool],
        *,
        on_started: Callable[[ServiceStarted], None] = lambda _: None,
    ) -> dict[str, Any]:
        """Be a bus until `stop_requested` returns True; the counts of its work, as JSON values.

        Raises InputError for a robot, world, model or fault that is not allowed.
        """
        options = self.servos.options()
        section = ServosSection() if options.robot_file is None else options.robot_file.content.servos
        servos = make_servos(self.servos.backend, options)
        make = {"servo2040": self._servo2040, "pca9685": self._pca9685}.get(self.driver, self._bus)
        board = make(servos, section)
        started = ServiceStarted(robot=servos.robot.name, backend=self.servos.backend, place=board.path)
        board.run(stop_requested, ready=lambda: _start(started, on_started))
        return board.report()

    def _bus(self, servos: LegServos, section: ServosSection) -> "SimulatedBoard":
        from hexctl.serve.boards.bus_board import BusBoard
        from hexctl.serve.boards.bus_faults import parse_bus_fault

        if self.model is not None:
            section = section.model_copy(update={"model": self.model})
        bus_map = bus_map_of(section, self.driver)
        faults = tuple(parse_bus_fault(text) for text in self.faults)
        return BusBoard(servos, bus_map, baud=self.bits_per_s, faults=faults, seed=self.servos.seed)

    def _servo2040(self, servos: LegServos, section: ServosSection) -> "SimulatedBoard":
        from hexctl.serve.boards.servo2040_board import Servo2040Board, parse_servo2040_fault

        pwm_map = pwm_map_of(section, self.driver)
        faults = tuple(parse_servo2040_fault(text) for text in self.faults)
        firmware = self.model or "stock"
        return Servo2040Board(servos, pwm_map, firmware=firmware, faults=faults, seed=self.servos.seed)

    def _pca9685(self, servos: LegServos, section: ServosSection) -> "SimulatedBoard":
        from hexctl.serve.boards.pca9685_board import Pca9685Board, parse_pca9685_fault

        if self.model is not None:
            raise InputError(f"{argument('model')}: got {self.model} with pca9685; allowed: without")
        return Pca9685Board(
            servos,
            pwm_map_of(section, self.driver),
            bits_per_s=self.bits_per_s,
            faults=tuple(parse_pca9685_fault(text) for text in self.faults),
            seed=self.servos.seed,
        )


def _start(started: ServiceStarted, on_started: Callable[[ServiceStarted], None]) -> None:
    """Take real-time priority, now that what takes long is done, and say that the board is there."""
    on_started(replace(started, realtime=request_realtime_priority()))
