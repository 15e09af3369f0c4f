"""Services that run until they are told to stop: a robot on the network, and a servo board.

Nothing here prints or handles signals: callers pass callbacks.
"""

import resource
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hexctl.backends.base import LegServos
from hexctl.backends.clock import request_realtime_priority
from hexctl.backends.port_servos import PortServos
from hexctl.backends.registry import BackendOptions, check_options, make_servos
from hexctl.errors import InputError, argument, check_type
from hexctl.robot.failure import Failure, failure_text
from hexctl.robot.failure_grammar import AskedFailures, AskedLegs, option_of, read_failures_before
from hexctl.robot.loader import load_robot_file
from hexctl.robot.servos.drivers import BUS_DRIVERS, PWM_DRIVERS
from hexctl.serve.ros.ros_options import RosOptions
from hexctl.serve.server import RobotServer
from hexctl.serve.stops.stop_file import StopFile
from hexctl.serve.stops.stop_place import StopPlace
from hexctl.wire.links import CLEAR_COMMAND, Endpoint, Link, load_link

if TYPE_CHECKING:
    from hexctl.backends.sim.world import World
    from hexctl.serve.keeper import Keeper

DEFAULT_WORLD = "flat"
MIN_SIT_AFTER_S, MAX_SIT_AFTER_S = 1.0, 3600.0
SERVED_BACKENDS = ("sim", "mavlink", *BUS_DRIVERS, *PWM_DRIVERS, "mock")

#: What is said at every start with a board that cannot be let down when its computer dies.
NO_WATCHDOG = (
    "{backend} has no watchdog and its servos no feedback: if this computer dies, they keep their last "
    "pulses; have a switch in their supply within reach"
)

#: What is said once the process that would let the robot down has gone.
KEEPER_LOST = "the keeper has ended: nothing lets the robot down if this process dies"

#: What is said at the end where servos go on by themselves.
STILL_HOLDS = "the robot holds its pose; its servos keep their torque"

#: The same where they could not be reached at the end.
NOT_KNOWN = "its servos cannot be reached, and what they do is not known: use the switch of their supply"


#: Open files of a server; each connection needs one.
MOST_DESCRIPTORS = 65_536


@dataclass(frozen=True, slots=True, kw_only=True)
class ServosSpec:
    """Servos to serve, before they are made.

    Attributes:
        backend: name of a backend, or `package.module:Class`.
        robot: name or path of the robot file.
        world: name or path of the simulated world; None is `flat`. Only with `sim`, or own servos that take
            one, as for the next two.
        failed_leg: legs of the simulation that failed, as in `RunSpec`.
        failure: how legs of the simulation failed, as in `RunSpec`.
        seed: of everything random in a simulation.
    """

    backend: str = "sim"
    robot: str = "ant"
    world: str | None = None
    failed_leg: AskedLegs = None
    failure: AskedFailures = ()
    seed: int = 0

    @property
    def failures(self) -> tuple[Failure, ...]:
        """Failures of the simulation, by leg; raises InputError for what is not allowed."""
        instead = "one from the start, such as 5:limp; hexctl twin fail lets a leg fail later"
        return read_failures_before(self.failure, self.failed_leg, instead)

    def check(self) -> None:
        """Raise InputError for wrong types, and for values that only a simulation can use."""
        check_type(self.backend, str, "backend", "the name of a backend, or package.module:Class")
        check_type(self.robot, str, "robot", "the name or path of a robot file")
        check_type(self.world, (str, type(None)), "world", "the name or path of a world, or None")
        check_type(self.seed, int, "seed")
        if self.seed < 0:
            raise InputError(f"{argument('seed')}: got {self.seed}; allowed: 0 or more")
        check_options(self.backend, world=self.world, seed=self.seed)
        for name, value in map(option_of, self.failures):
            check_options(self.backend, names={"failure": name}, failure=value)

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
            failure=next(iter(self.failures), None),
            further_failures=self.failures[1:],
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
        return {"world": self.world or DEFAULT_WORLD, "failure": failure_text(*self.failures)}

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
    realtime: bool = False
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
        check_between(argument("sit_after_s"), self.sit_after_s, MIN_SIT_AFTER_S, MAX_SIT_AFTER_S)

    def resolved_link(self) -> Link:
        """Link that the options describe; raises InputError for a bad link file.

        With ROS, the port of the ROS router is left to it (`RosOptions.link_beside`).
        """
        link = load_link(
            self.link,
            endpoint=self.listen,
            credentials=self.credentials,
            insecure=self.insecure,
            given_as="listen",
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
        _raise_descriptor_limit()
        link = self.resolved_link()
        options = self.servos.options(
            connect=self.device, credentials=self.device_keys, insecure=self.insecure
        )
        servos = _made_servos(self.servos.backend, options)
        keeper = self._keeper(options)
        simulated = self.servos.simulated is not None
        place, clear = self._stop_place(options, link), _clear_command(link)
        stop_file = StopFile(servos.robot.name, place, asked_only=simulated, clear=clear)
        server = RobotServer(
            servos,
            link,
            backend=self.servos.backend,
            simulated=self.servos.simulated,
            sit_after_s=self.sit_after_s,
            on_event=on_event,
            on_tick=_ticks_of(keeper),
            ros=None if self.ros is None else self.ros.bridge(servos.robot, insecure=self.insecure),
            stop_file=stop_file,
            clear=clear,
        )
        started = ServiceStarted(
            robot=servos.robot.name,
            backend=self.servos.backend,
            place=link.endpoint,
            warnings=self._warnings(link) + stop_file.warnings,
        )
        held = False

        def stop() -> bool:
            nonlocal held
            if not stop_requested():
                return False
            held = isinstance(servos, PortServos) and servos.holds
            return True

        def ready() -> None:
            warnings = started.warnings + server.warnings
            on_started(replace(started, realtime=request_realtime_priority(), warnings=warnings))

        _run_kept(server, stop, keeper, ready=ready)
        if held:
            on_event(STILL_HOLDS if server.reaches_servos else NOT_KNOWN)

    def _stop_place(self, options: BackendOptions, link: Link) -> StopPlace:
        """Where the robot is, for the file of its stop."""
        backend, port = self.servos.backend, self.device
        if port is None and backend in (*BUS_DRIVERS, *PWM_DRIVERS) and options.robot_file is not None:
            port = options.robot_file.content.servos.port
        return StopPlace.of(backend, port, link.endpoint)

    def _warnings(self, link: Link) -> tuple[str, ...]:
        """What the operator must know before anything moves."""
        pwm = self.servos.backend in PWM_DRIVERS
        board = (NO_WATCHDOG.format(backend=self.servos.backend),) if pwm else ()
        return board + (() if self.ros is None else self.ros.warnings(link))

    def _keeper(self, options: BackendOptions) -> "Keeper | None":
        """Process that lets the robot down, or hold, when this one has ended without doing so."""
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


def _made_servos(backend: str, options: BackendOptions) -> LegServos:
    """Servos of a backend; messages name the port as it was given here, as `device`."""
    try:
        return make_servos(backend, options)
    except InputError as error:
        given_as = {"connect": "device"}
        raise type(error)(error.worded(lambda name: argument(given_as.get(name, name)))) from error.__cause__


def _clear_command(link: Link) -> str:
    """Command that ends a stop of a robot that listens at a link, as far as it is known here."""
    reached = link.credentials is None and not Endpoint.parse(link.endpoint).is_everywhere
    return link.clear_command if reached else CLEAR_COMMAND


def _run_kept(
    server: RobotServer, stop: Callable[[], bool], keeper: "Keeper | None", *, ready: Callable[[], None]
) -> None:
    """Serve until told to stop, looked after by a keeper where there is one."""
    if keeper is None:
        server.run(stop, ready=ready)
        return
    try:
        server.run(_with_goodbye(stop, keeper), ready=ready)
    except BaseException:
        keeper.abandon()
        raise
    keeper.dismiss()


def _with_goodbye(stop_requested: Callable[[], bool], keeper: "Keeper") -> Callable[[], bool]:
    """Question whether to stop that tells the keeper of a yes."""

    def stop() -> bool:
        if not stop_requested():
            return False
        keeper.goodbye()
        return True

    return stop


def _ticks_of(keeper: "Keeper | None") -> Callable[[], str | None]:
    """What is done in every control period for a keeper; its loss is an event, once."""

    def tick() -> str | None:
        if keeper is None or keeper.lost:
            return None
        keeper.tick()
        return KEEPER_LOST if keeper.lost else None

    return tick


def check_between(option: str, value: float, lowest: float, highest: float) -> None:
    """Raise InputError for a time in s that is not between two others."""
    if not lowest <= value <= highest:  # false for nan too
        raise InputError(f"{option}: got {value:g}; allowed: {lowest:g} to {highest:g} s")


def _raise_descriptor_limit() -> None:
    """Allow as many open files as the system lets this user have: connections that are given up hold some."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = MOST_DESCRIPTORS if most == resource.RLIM_INFINITY else min(most, MOST_DESCRIPTORS)
    resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, most))


def serve(
    *,
    backend: str = "sim",
    robot: str = "ant",
    world: str | None = None,
    failed_leg: AskedLegs = None,
    failure: AskedFailures = (),
    seed: int = 0,
    stop_requested: Callable[[], bool] = lambda: False,
    on_started: Callable[[ServiceStarted], None] = lambda _: None,
    on_event: Callable[[str], None] = lambda _: None,
    **options: Any,
) -> None:
    """Put a robot on the network, as `hexctl serve` does.

    Blocks until `stop_requested` returns True or a KeyboardInterrupt.

    Args:
        backend: name of a backend, or `package.module:Class`.
        robot: name or path of the robot file.
        world: name or path of the simulated world; None is `flat`. Only with `sim`.
        failed_leg: legs of the simulation that failed, as in `RunSpec`. Only with `sim`.
        failure: how legs of the simulation failed, as in `RunSpec`. Only with `sim`.
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
    spec = ServosSpec(
        backend=backend, robot=robot, world=world, failed_leg=failed_leg, failure=failure, seed=seed
    )
    RobotService(servos=spec, **options).run(stop_requested, on_started=on_started, on_event=on_event)
