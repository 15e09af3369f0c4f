"""Services that run until stopped: a robot on the network. They report by callbacks and handle no signals."""

import resource
from collections.abc import Callable
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hexctl.backends.base import LegServos, check_stance
from hexctl.backends.clock import realtime_priority
from hexctl.backends.pwm.pulse_board import find_board
from hexctl.backends.registry import BackendOptions, has_keeper, make_servos
from hexctl.backends.ticked_servos import PortServos
from hexctl.errors import InputError, argument
from hexctl.options import check_names
from hexctl.robot.servos.drivers import is_board, is_driver
from hexctl.server.serve_options import ServeOptions
from hexctl.server.server import RobotServer
from hexctl.server.stops.stop_file import StopFile
from hexctl.wire.links import CLEAR_COMMAND, Endpoint, Link, load_link

if TYPE_CHECKING:
    from hexctl.server.keeper import Keeper

NO_WATCHDOG = (
    "{backend} has no watchdog and its servos no feedback: if this computer dies, they keep their last "
    "pulses; have a switch in their supply within reach"
)

#: Last line if servos hold by themselves.
STILL_HOLDS = "the robot holds its pose; its servos keep their torque"

#: Last line if the servos could not be reached.
NOT_KNOWN = "its servos cannot be reached, and what they do is not known: use the switch of their supply"


#: Endpoint of a robot when the ROS router of its computer has the default port.
ENDPOINT_BESIDE_ROUTER = "tcp/127.0.0.1:7448"

#: Open files of a server; each connection needs one.
MOST_DESCRIPTORS = 65_536


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceStarted:
    """Report of a service once clients can connect.

    Attributes:
        place: Zenoh endpoint or MAVLink port.
        realtime: whether its process has real-time priority.
        warnings: for the operator, before anything moves.
    """

    robot: str
    backend: str
    place: str
    realtime: bool = False
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotService(ServeOptions):
    """A robot on the network: options of a `RobotServer`, checked when they are given.

    service = RobotService(backend="sim", robot="ant")
    service.run(stop_requested)
    """

    def resolved_link(self) -> Link:
        """Link of the options; a ROS router keeps its port. Raises InputError for a bad link file."""
        link = load_link(
            self.link,
            connect=self.listen,
            credentials=None if self.credentials is None else Path(self.credentials),
            insecure=self.insecure,
            given_as="listen",
        )
        return link if self.ros is None else link_beside_router(link, self.ros)

    def run(
        self,
        stop_requested: Callable[[], bool],
        *,
        on_started: Callable[[ServiceStarted], None] = lambda _: None,
        on_event: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Serve until `stop_requested` returns True; arguments as in `serve`.

        Raises InputError for an invalid robot, world or link, RobotFaultError when the servos
        cannot be reached or fail, or the endpoint cannot be used.
        """
        _raise_descriptor_limit()
        link = self.resolved_link()
        keys = None if self.device_keys is None else Path(self.device_keys)
        options = self.backend_options(credentials=keys, insecure=self.insecure)
        servos = make_servos(self.backend, options)
        check_stance(servos)
        keeper = self._keeper(options)
        stop_file = self._stop_file(servos.robot.name, options, link)
        server = self._server(servos, link, keeper, stop_file, on_event)
        held = False

        def stop() -> bool:
            nonlocal held
            if not stop_requested():
                return False
            priority.close()  # the end may take long, and keeps no time
            held = isinstance(servos, PortServos) and servos.holds
            if keeper is not None:
                keeper.goodbye()
            return True

        def ready() -> None:
            on_started(
                ServiceStarted(
                    robot=servos.robot.name,
                    backend=self.backend,
                    place=link.endpoint,
                    realtime=priority.enter_context(realtime_priority()),
                    warnings=self._warnings(link) + stop_file.warnings + server.warnings,
                )
            )

        with keeper or nullcontext(), ExitStack() as priority:
            server.run(stop, ready=ready)
        if held:
            on_event(STILL_HOLDS if server.reaches_servos else NOT_KNOWN)

    def _server(
        self,
        servos: LegServos,
        link: Link,
        keeper: "Keeper | None",
        stop_file: StopFile,
        on_event: Callable[[str], None],
    ) -> RobotServer:
        bridge = None
        if self.ros is not None:
            from hexctl.server.ros.bridge import RosBridge
            from hexctl.server.ros.settings import RosSettings

            bridge = partial(
                RosBridge,
                servos.robot,
                self.ros_node,
                router=self.ros,
                settings=RosSettings(sit_after_s=self.sit_after_s, ros_drive=self.ros_drive),
                insecure=self.insecure,
                time=servos.clock.time,
            )
        return RobotServer(
            servos,
            link,
            backend=self.backend,
            simulated=self.simulated,
            sit_after_s=self.sit_after_s,
            on_event=on_event,
            keeper=keeper,
            ros=bridge,
            stop_file=stop_file,
            clear=_clear_command(link),
        )

    def _stop_file(self, robot: str, options: BackendOptions, link: Link) -> StopFile:
        backend, port = self.backend, self.port
        if port is None and is_driver(backend) and options.robot_file is not None:
            port = options.robot_file.content.servos.port
        simulated, clear = self.simulated is not None, _clear_command(link)
        return StopFile(robot, backend, port or link.endpoint, asked_only=simulated, clear=clear)

    def _warnings(self, link: Link) -> tuple[str, ...]:
        dies = is_board(self.backend) and not find_board(self.backend).has_watchdog
        board = (NO_WATCHDOG.format(backend=self.backend),) if dies else ()
        if self.ros is None:
            return board
        return board + router_warnings(link, self.ros, drive=self.ros_drive)

    def _keeper(self, options: BackendOptions) -> "Keeper | None":
        from hexctl.server.keeper import Keeper, KeeperSpec

        if not has_keeper(self.backend) or options.robot_file is None:
            return None
        return Keeper(
            KeeperSpec(
                backend=self.backend,
                robot=str(self.robot),
                port=self.port,
                sits=options.robot_file.content.servos.if_computer_dies == "sit",
            )
        )


def _clear_command(link: Link) -> str:
    reached = link.credentials is None and not Endpoint.parse(link.endpoint).is_everywhere
    return link.clear_command if reached else CLEAR_COMMAND


def link_beside_router(link: Link, router: str) -> Link:
    """Link that leaves the router its port; raises InputError if the options name that port."""
    own, ros = Endpoint.parse(link.endpoint), Endpoint.parse(router)
    here = ros.is_loopback and (own.is_loopback or own.is_everywhere)
    if own.port != ros.port or not here:
        return link
    if link.named:
        raise InputError(
            f"{argument('listen')}: got {link.endpoint}, where {argument('ros')} expects the ROS router; "
            f"allowed: another port, such as {ENDPOINT_BESIDE_ROUTER}"
        )
    return replace(link, endpoint=ENDPOINT_BESIDE_ROUTER, named=True)


def router_warnings(link: Link, router: str, *, drive: bool) -> tuple[str, ...]:
    """Warnings for the operator before anything moves; `drive` is whether ROS may move the robot."""
    beside = f"its usual port is left to the ROS router: clients need --connect {link.endpoint}"
    who = f"whoever reaches the ROS router at {router}"
    may = f"{who} may stop this robot; what would move it is not taken without --ros-drive"
    if drive:
        may = f"{who} may drive this robot (--ros-drive): ROS asks for no password"
    return (*((beside,) if link.endpoint == ENDPOINT_BESIDE_ROUTER else ()), may)


def _raise_descriptor_limit() -> None:
    """Abandoned connections hold descriptors for a while."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = MOST_DESCRIPTORS if most == resource.RLIM_INFINITY else min(most, MOST_DESCRIPTORS)
    resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, most))


def serve(
    *,
    stop_requested: Callable[[], bool] = lambda: False,
    on_started: Callable[[ServiceStarted], None] = lambda _: None,
    on_event: Callable[[str], None] = lambda _: None,
    **options: Any,
) -> None:
    """Put a robot on the network, as `hexctl serve` does.

    Blocks until `stop_requested` returns True or a KeyboardInterrupt.

    Args:
        stop_requested: called at every tick.
        on_started: called once, when clients can connect.
        on_event: takes a line for each change of controller, stop and posture.
        options: fields of `hexctl.server.serve_options.ServeOptions`.

    Raises what `RobotService.run` raises.
    """
    check_names(serve, options, RobotService)
    RobotService(**options).run(stop_requested, on_started=on_started, on_event=on_event)
