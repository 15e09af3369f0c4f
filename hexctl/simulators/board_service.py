"""Simulated servo boards and buses as a service, without output or signals."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from hexctl.backends.base import LegServos
from hexctl.backends.bus.bus_map import bus_map_of
from hexctl.backends.bus.family import find_family
from hexctl.backends.clock import realtime_priority
from hexctl.backends.pwm.pulse_board import find_board, pwm_map_of
from hexctl.backends.registry import BackendOptions, make_servos
from hexctl.errors import InputError, argument
from hexctl.options import RARE, Panel, Range, Typed, check_used
from hexctl.robot.servos.drivers import BAUD, all_drivers, is_board, is_driver
from hexctl.server.serve_options import ServedOptions

if TYPE_CHECKING:
    from hexctl.backends.mavlink.mavlink_transport import Port
    from hexctl.server.service import ServiceStarted
    from hexctl.simulators.servo_board import ServoBoard
    from hexctl.simulators.simulated_board import SimulatedBoard, SimulatedPulseBoard

BoardBackend = Literal["sim", "mock"]
EXPIRY_S = Range(low=0.05, high=1, unit="s")
RELEASE_S = Range(low=1, high=3600, unit="s")

CONNECTION = Panel("Connection")

#: Options that only a MAVLink board uses, and that only a bus uses.
OF_BOARD = ("port", "pty", "expiry_s", "release_after_s", "credentials", "insecure", "link")
OF_BUS = ("model", "baud", "fault", "link")


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardService(ServedOptions):
    """Options of a simulated robot behind a MAVLink board, a bus, or PWM boards.

    Raises InputError for an invalid value.
    """

    PANEL: ClassVar = "Servo bus"

    backend: BoardBackend = "sim"
    """What the servos move: sim (simulation in real time) or mock (nothing)."""

    port: str | None = None
    """Where controllers reach it: udpin:HOST:PORT (waits), udpout:HOST:PORT (calls) or a serial device such
    as /dev/ttyACM0:115200. (default: udpin:127.0.0.1:14550)
    """

    credentials: Annotated[str | Path | None, Typed(flag="keys"), RARE] = None
    """Folder with mavlink.key, the board's secret: only what it signed is obeyed. (default: none)"""

    insecure: Annotated[bool, RARE] = False
    """Let others than this computer command without that secret."""

    pty: Annotated[bool, CONNECTION] = False
    """Make a serial device instead, a pseudo-terminal, and print its name."""

    expiry_s: Annotated[float, EXPIRY_S, CONNECTION, RARE] = 0.2
    """Seconds without a command until the pose is held, {}."""

    release_after_s: Annotated[float, RELEASE_S, CONNECTION, RARE] = 10.0
    """Seconds without the controller until torque is disabled, {}."""

    bus: Annotated[str | None, Typed(words="buses")] = None
    """Simulate servos on a serial bus instead, on a pseudo-terminal: dynamixel, feetech, lx16a, that of a
    plug-in, or a board of hobby servos: servo2040, maestro, ssc32; or two boards pca9685, on a socket.
    (default: a MAVLink board)
    """

    model: str | None = None
    """With --bus, model of all servos, such as ax12a or sts3215; with servo2040 its firmware, stock or fork;
    with maestro mini24, mini18, mini12 or micro6, with ssc32 ssc32u or ssc32, which has no binary commands.
    (default: that of the robot file, else the usual one of the bus)
    """

    baud: Annotated[int | None, BAUD, RARE] = None
    """With --bus, bits per second: how long packets take, {}. (default: the usual one of the bus)"""

    fault: Sequence[str] = ()
    """With --bus, what goes wrong, repeatable: mute:5:coxa@10, hot:2:femur:72@5, overload:4:femur@6,
    lost-id:3:tibia@8, same-id:3:tibia (that of the joint before it), only:1:coxa (all others are unplugged),
    bad-cable:3:femur:0.2, brown-out@12, battery:8.5@9 (volts), unplug@15, replug@18, garble:0.01, wild:0.01,
    wild-once@5, noise:0.5, echo; with servo2040 mute@10, trip:12@10, unplug@15, replug@18, garble:0.01; with
    maestro and ssc32 the same but trip, and reset@10, torn:0.01; with maestro no-timeout, narrow, ignore,
    crc; with pca9685 nack:0.01, reset@10, unplug@15, replug@18. (default: nothing)
    """

    def __post_init__(self) -> None:
        super(BoardService, self).__post_init__()
        if self.bus is None:
            check_used(self, OF_BUS, f"with {argument('bus')}")
        else:
            check_used(self, OF_BOARD, f"without {argument('bus')}")
        if self.bus is not None and not is_driver(self.bus):
            raise InputError(f"{argument('bus')}: got {self.bus}; allowed: {', '.join(all_drivers())}")
        if self.pty and self.port is not None:
            raise InputError(
                f"{argument('pty')}: got {argument('port')} {self.port} too; allowed: one or the other"
            )

    @property
    def signed(self) -> bool:
        """Whether only signed frames are accepted."""
        return self.credentials is not None

    @property
    def bits_per_s(self) -> int:
        """Speed of the line of a bus; 0 for a MAVLink board or a USB device."""
        if self.bus is None:
            return 0
        if is_board(self.bus):
            return self.baud or _twin_of(self.bus).usual_baud or 0
        return self.baud or find_family(self.bus, named=argument("bus")).bauds[0]

    def run(
        self,
        stop_requested: Callable[[], bool],
        *,
        on_started: "Callable[[ServiceStarted], None]" = lambda _: None,
    ) -> dict[str, Any]:
        """Run until `stop_requested` returns True; the result is its counts, as JSON values.

        Raises InputError for an invalid port, robot, world, model or fault, RobotFaultError when
        the port cannot be opened or fails.
        """
        from hexctl.server.service import ServiceStarted

        # The protocol of the board decides what of it a controller gets to know.
        options = replace(self.backend_options(), all_sensors=self.backend == "sim")
        servos = make_servos(self.backend, options)
        make = self._mavlink if self.bus is None else self._simulated
        board, place = make(servos, options)
        started = ServiceStarted(robot=servos.robot.name, backend=self.backend, place=place)

        with ExitStack() as priority:

            def ready() -> None:  # real-time priority, now that what takes long is done
                on_started(replace(started, realtime=priority.enter_context(realtime_priority())))

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
        text = self.port or transport.DEFAULT_BOARD_PORT
        address, option = transport.parse_port(text), argument("port")
        transport.check_guarded(address, option=option, text=text, signed=self.signed, insecure=self.insecure)
        return transport.open_port(address, text=text), text

    def _simulated(self, servos: LegServos, options: BackendOptions) -> "tuple[SimulatedBoard, str]":
        from hexctl.simulators.bus_board import BusBoard

        driver, section = str(self.bus), options.servos_section
        board: SimulatedBoard
        if is_board(driver):
            twin = _twin_of(driver)
            more = {"model": self.model, "baud": self.baud, **self._faults(twin)}
            board = twin(servos, pwm_map_of(section, driver), **more)
        else:
            given = {} if self.model is None else {"model": self.model}
            own = section.model_copy(update=given)
            bus_map = bus_map_of(own, driver, named=argument("bus"), moves=True)
            more = self._faults(BusBoard)
            board = BusBoard(servos, bus_map, baud=self.bits_per_s, **more)
        return board, board.path

    def _faults(self, board: "type[SimulatedBoard]") -> dict[str, Any]:
        from hexctl.simulators.board_faults import parse_fault

        return {"faults": tuple(parse_fault(text, board.kinds) for text in self.fault), "seed": self.seed}


def _twin_of(driver: str) -> "type[SimulatedPulseBoard]":
    """Class of the simulated board of a driver."""
    twin: type[SimulatedPulseBoard] = resolve_name(find_board(driver, named=argument("bus")).simulated)
    return twin
