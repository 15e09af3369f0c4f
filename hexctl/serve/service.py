"""Services that run until they are told to stop: a robot on the network, and a servo board.

Nothing here prints or handles signals: callers pass callbacks.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hexctl.backends.base import LegServos
from hexctl.backends.clock import request_realtime_priority
from hexctl.backends.registry import BackendOptions, check_options, make_servos
from hexctl.errors import InputError, argument, check_type
from hexctl.robot.bus_map import bus_map_of
from hexctl.robot.drivers import BUS_DRIVERS, PWM_DRIVERS
from hexctl.robot.failure import Failure, failure_text
from hexctl.robot.loader import load_robot_file
from hexctl.robot.pwm_map import pwm_map_of
from hexctl.robot.schema import ServosSection
from hexctl.robot.servo_models import DEFAULT_BAUDS
from hexctl.serve.ros.options import RosOptions
from hexctl.serve.server import RobotServer
from hexctl.wire.links import Link, load_link

if TYPE_CHECKING:
    from hexctl.backends.mavlink.transport import Port, PortAddress
    from hexctl.backends.sim.world import World
    from hexctl.serve.keeper import Keeper
    from hexctl.serve.simulated_board import SimulatedBoard

DEFAULT_WORLD = "flat"
MIN_SIT_AFTER_S, MAX_SIT_AFTER_S = 1.0, 3600.0
MIN_EXPIRY_S, MAX_EXPIRY_S = 0.05, 1.0
MIN_RELEASE_S, MAX_RELEASE_S = 1.0, 3600.0
SERVED_BACKENDS = ("sim", "mavlink", *BUS_DRIVERS, *PWM_DRIVERS, "mock")
BOARD_BACKENDS = ("sim", "mock")

#: What is said at every start with a board that cannot be let down when its computer dies.
NO_WATCHDOG = (
    "{backend} has no watchdog and its servos no feedback: if this computer dies, they keep their last "
    "pulses; have a switch in their supply within reach"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ServosSpec:
    """Servos to serve, before they are made.

    Attributes:
        backend: name of a backend, or `package.module:Class`.
        robot: name or path of the robot file.
        world: name or path of the simulated world; None is `flat`. Only with `sim`, or own servos that take
            one, as for the next two.
        failure: failed leg of the simulation, or None.
        seed: of everything random in a simulation.
    """

    backend: str = "sim"
    robot: str = "ant"
    world: str | None = None
    failure: Failure | None = None
    seed: int = 0

    def check(self) -> None:
        """Raise InputError for wrong types, and for values that only a simulation can use."""
        check_type(self.backend, str, "backend", "the name of a backend, or package.module:Class")
        check_type(self.robot, str, "robot", "the name or path of a robot file")
        check_type(self.world, (str, type(None)), "world", "the name or path of a world, or None")
        check_type(self.failure, (Failure, type(None)), "failure", "a Failure, as Failure(leg=5), or None")
        check_type(self.seed, int, "seed")
        if self.seed < 0:
            raise InputError(f"{argument('seed')}: got {self.seed}; allowed: 0 or more")
        check_options(
            self.backend,
            names={"failure": "failure.leg"},
            world=self.world,
            failure=None if self.failure is None else self.failure.leg,
            seed=self.seed,
        )

    def options(
        self, *, connect: str | None = None, credentials: Path | None = None, insecure: bool = False
    ) -> BackendOptions:
        """Options of the backend, in real time.

        Args:
            connect: port of a servo board, or None for the default.
            credentials: folder with the key of a servo board, or None.
            insecure: whether a board beyond this computer may do without that key.
        """
        file = load_robot_file(self.robot)
        return BackendOptions.of(
            self,
            robot=file.robot,
            world=self._world(),
            realtime=True,
            robot_file=file,
            connect=connect,
            credentials=credentials,
            insecure=insecure,
        )

    @property
    def simulated(self) -> dict[str, str] | None:
        """World and failure of a simulation as text, for the status; None for other servos."""
        if self.backend != "sim":
            return None
        return {"world": self.world or DEFAULT_WORLD, "failure": failure_text(self.failure)}

    def _world(self) -> "World | None":
        if self.backend != "sim" and self.world is None:
            return None
        from hexctl.backends.sim.world import load_world

        return load_world(self.world or DEFAULT_WORLD)


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceStarted:
    """What a service reports once clients can connect.

    Attributes:
        robot: name of the robot.
        backend: name of its backend.
        place: where clients reach it: a Zenoh endpoint or a MAVLink port.
        realtime: whether its process has real-time priority.
        warnings: what the operator must know before anything moves.
    """

    robot: str
    backend: str
    place: str
    realtime: bool
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotService:
    """A robot on the network: options of a `RobotServer`, checked when they are given.

        service = RobotService(servos=ServosSpec(backend="sim", robot="ant"))
        service.run(stop_requested)

    Attributes:
        servos: what is served.
        listen: Zenoh endpoint to listen at; None is that of the link, or the default.
        device: port of the servo board for `mavlink`, of the bus for `BUS_DRIVERS`.
        device_keys: folder with the key of the servo board, for `mavlink` only.
        sit_after_s: seconds without a command until the robot sits down and its torque is switched off.
        credentials: folder of certificates, or None.
        insecure: whether a link beyond this computer may do without certificates.
        link: name or path of a link file, or None.
        ros: how it takes part in ROS 2, or None.
    """

    servos: ServosSpec = field(default_factory=ServosSpec)
    listen: str | None = None
    device: str | None = None
    device_keys: Path | None = None
    sit_after_s: float = 10.0
    credentials: Path | None = None
    insecure: bool = False
    link: str | None = None
    ros: RosOptions | None = None

    def __post_init__(self) -> None:
        check_type(self.ros, (RosOptions, type(None)), "ros", "RosOptions, as RosOptions(domain=1), or None")
        check_type(self.servos, ServosSpec, "servos", "a ServosSpec, as ServosSpec(robot='ant') gives")
        check_type(self.sit_after_s, float, "sit_after_s")
        backend = self.servos.backend
        if backend == "zenoh":
            raise InputError(
                f"{argument('backend')}: got zenoh, which is a robot that is served already; "
                f"allowed: {', '.join(SERVED_BACKENDS)}"
            )
        self.servos.check()
        check_options(
            backend,
            names={"connect": "device", "credentials": "device_keys"},
            offered=SERVED_BACKENDS,
            connect=self.device,
            credentials=self.device_keys,
        )
        _check_between(argument("sit_after_s"), self.sit_after_s, MIN_SIT_AFTER_S, MAX_SIT_AFTER_S)

    def resolved_link(self) -> Link:
        """Link that the options describe; raises InputError for a bad link file.

        With ROS, the port of the ROS router is left to it (`RosOptions.link_beside`).
        """
        link = load_link(
            self.link, endpoint=self.listen, credentials=self.credentials, insecure=self.insecure
        )
        return link if self.ros is None else self.ros.link_beside(link)

    def run(
        self,
        stop_requested: Callable[[], bool],
        *,
        on_started: Callable[[ServiceStarted], None] = lambda _: None,
        on_event: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Serve until `stop_requested` returns True.

        Args:
            stop_requested: asked at every tick.
            on_started: called once, when clients can connect.
            on_event: called with a line for each change of controller, stop and posture.

        Raises InputError for a robot, world or link that is not allowed, RobotFaultError when the servos
        cannot be reached or fail, or the endpoint cannot be listened at.
        """
        link = self.resolved_link()
        options = self.servos.options(
            connect=self.device, credentials=self.device_keys, insecure=self.insecure
        )
        servos = make_servos(self.servos.backend, options)
        keeper = self._keeper(options)
        server = RobotServer(
            servos,
            link,
            backend=self.servos.backend,
            simulated=self.servos.simulated,
            sit_after_s=self.sit_after_s,
            on_event=on_event,
            on_tick=_ticks_of(keeper, on_event),
            ros=None if self.ros is None else self.ros.bridge(servos.robot, insecure=self.insecure),
        )
        realtime = request_realtime_priority()
        started = ServiceStarted(
            robot=servos.robot.name,
            backend=self.servos.backend,
            place=link.endpoint,
            realtime=realtime,
            warnings=self._warnings(link),
        )
        if keeper is None:
            server.run(stop_requested, ready=lambda: on_started(started))
            return
        try:
            server.run(_with_goodbye(stop_requested, keeper), ready=lambda: on_started(started))
        except BaseException:
            keeper.abandon()
            raise
        keeper.dismiss()

    def _warnings(self, link: Link) -> tuple[str, ...]:
        """What the operator must know before anything moves."""
        pwm = self.servos.backend in PWM_DRIVERS
        board = (NO_WATCHDOG.format(backend=self.servos.backend),) if pwm else ()
        return board + (() if self.ros is None else self.ros.warnings(link))

    def _keeper(self, options: BackendOptions) -> "Keeper | None":
        """Process that looks after servos on a bus, which hold for ever, when this one has gone."""
        from hexctl.serve.keeper import KEPT_BACKENDS, Keeper, KeeperSpec

        if self.servos.backend not in KEPT_BACKENDS or options.robot_file is None:
            return None
        return Keeper(
            KeeperSpec(
                backend=self.servos.backend,
                robot=self.servos.robot,
                connect=self.device,
                sits=options.robot_file.content.servos.if_computer_dies == "sit",
            )
        )


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
        _check_between(argument("expiry_s"), self.expiry_s, MIN_EXPIRY_S, MAX_EXPIRY_S)
        _check_between(argument("release_after_s"), self.release_after_s, MIN_RELEASE_S, MAX_RELEASE_S)

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
        from hexctl.serve.servo_board import ServoBoard

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
        realtime = request_realtime_priority()
        started = ServiceStarted(
            robot=servos.robot.name, backend=self.servos.backend, place=place, realtime=realtime
        )
        board.run(stop_requested, ready=lambda: on_started(started))
        return board.report()

    def _check_port(self) -> "PortAddress | None":
        """Address of the port, None for a pseudo-terminal."""
        from hexctl.backends.mavlink.transport import DEFAULT_BOARD_PORT, check_guarded, parse_port

        if self.pty:
            return None
        text = self.port or DEFAULT_BOARD_PORT
        address = parse_port(text)
        check_guarded(address, option=argument("port"), text=text, signed=self.signed, insecure=self.insecure)
        return address

    def _open_port(self, address: "PortAddress | None") -> "tuple[Port, str]":
        """Opened port, and where controllers reach it."""
        from hexctl.backends.mavlink.transport import DEFAULT_BOARD_PORT, PtyPort, open_port

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
        realtime = request_realtime_priority()
        started = ServiceStarted(
            robot=servos.robot.name, backend=self.servos.backend, place=board.path, realtime=realtime
        )
        board.run(stop_requested, ready=lambda: on_started(started))
        return board.report()

    def _bus(self, servos: LegServos, section: ServosSection) -> "SimulatedBoard":
        from hexctl.serve.bus_board import BusBoard
        from hexctl.serve.bus_faults import parse_bus_fault

        if self.model is not None:
            section = section.model_copy(update={"model": self.model})
        bus_map = bus_map_of(section, self.driver)
        faults = tuple(parse_bus_fault(text) for text in self.faults)
        return BusBoard(servos, bus_map, baud=self.bits_per_s, faults=faults, seed=self.servos.seed)

    def _servo2040(self, servos: LegServos, section: ServosSection) -> "SimulatedBoard":
        from hexctl.serve.servo2040_board import Servo2040Board, parse_servo2040_fault

        pwm_map = pwm_map_of(section, self.driver)
        faults = tuple(parse_servo2040_fault(text) for text in self.faults)
        firmware = self.model or "stock"
        return Servo2040Board(servos, pwm_map, firmware=firmware, faults=faults, seed=self.servos.seed)

    def _pca9685(self, servos: LegServos, section: ServosSection) -> "SimulatedBoard":
        from hexctl.serve.pca9685_board import Pca9685Board, parse_pca9685_fault

        if self.model is not None:
            raise InputError(f"{argument('model')}: got {self.model} with pca9685; allowed: without")
        return Pca9685Board(
            servos,
            pwm_map_of(section, self.driver),
            bits_per_s=self.bits_per_s,
            faults=tuple(parse_pca9685_fault(text) for text in self.faults),
            seed=self.servos.seed,
        )


def _with_goodbye(stop_requested: Callable[[], bool], keeper: "Keeper") -> Callable[[], bool]:
    """Question whether to stop that tells the keeper of a yes."""

    def stop() -> bool:
        if not stop_requested():
            return False
        keeper.goodbye()
        return True

    return stop


def _ticks_of(keeper: "Keeper | None", on_event: Callable[[str], None]) -> Callable[[], None]:
    """What is done in every control period for a keeper; its loss is an event, once."""
    told = False

    def tick() -> None:
        nonlocal told
        if keeper is None or told:
            return
        keeper.tick()
        if keeper.lost:
            told = True
            on_event("the keeper has ended: nothing lets the robot down if this process dies")

    return tick


def _check_between(option: str, value: float, lowest: float, highest: float) -> None:
    if not lowest <= value <= highest:  # false for nan too
        raise InputError(f"{option}: got {value:g}; allowed: {lowest:g} to {highest:g} s")


def serve(
    *,
    backend: str = "sim",
    robot: str = "ant",
    world: str | None = None,
    failure: Failure | None = None,
    seed: int = 0,
    stop_requested: Callable[[], bool] = lambda: False,
    on_started: Callable[[ServiceStarted], None] = lambda _: None,
    on_event: Callable[[str], None] = lambda _: None,
    **options: Any,
) -> None:
    """Put a robot on the network, as `hexctl serve` does; also called as `hexctl.serve(...)`.

    Blocks until `stop_requested` returns True or a KeyboardInterrupt.

    Args:
        backend: name of a backend, or `package.module:Class`.
        robot: name or path of the robot file.
        world: name or path of the simulated world; None is `flat`. Only with `sim`.
        failure: failed leg of the simulation, or None. Only with `sim`.
        seed: of everything random in a simulation.
        stop_requested: asked at every tick.
        on_started: called once, when clients can connect.
        on_event: called with a line for each change of controller, stop and posture.
        options: further fields of `RobotService`: `listen`, `device`, `device_keys`, `sit_after_s`,
            `credentials`, `insecure`, `link`, `ros`.

    Raises what `RobotService.run` raises.
    """
    known = [field.name for field in fields(RobotService) if field.name != "servos"]
    unknown = [name for name in options if name not in known]
    if unknown:
        raise InputError(f"serve: got {', '.join(unknown)}; allowed: {', '.join(known)}")
    spec = ServosSpec(backend=backend, robot=robot, world=world, failure=failure, seed=seed)
    RobotService(servos=spec, **options).run(stop_requested, on_started=on_started, on_event=on_event)
