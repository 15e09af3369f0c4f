"""The one table of backends: from a name to connected-to-be servos, importing only what is asked for."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hexctl.backends.base import LegServos
from hexctl.errors import InputError, MissingExtraError
from hexctl.robot.failure import Failure
from hexctl.robot.loader import RobotFile
from hexctl.robot.model import Robot
from hexctl.robot.plugins import module_here
from hexctl.robot.servo_map import ServoMap, default_servo_map

if TYPE_CHECKING:
    from hexctl.backends.sim.world import World


@dataclass(frozen=True, slots=True, kw_only=True)
class BackendOptions:
    """What a backend may be told; each uses what concerns it.

    Attributes:
        robot: the robot at the other end.
        world: the simulated world, for `sim` only.
        failure: the failed leg that a simulation injects.
        seed: of everything random in a simulation.
        trial: number of the trial, which has sensor noise of its own.
        realtime: pace a simulation with the wall clock.
        robot_file: the file that the robot was loaded from, with the servo map of a real one; None for a
            robot that is not from a file.
        connect: where the robot is: a Zenoh endpoint, or a MAVLink port; None for the backend's default.
        credentials: folder with the certificates of a link beyond loopback, or None.
        insecure: True to let a link beyond loopback do without.
        link: name or path of a link file, or None.
    """

    robot: Robot
    world: "World | None" = None
    failure: Failure | None = None
    seed: int = 0
    trial: int = 0
    realtime: bool = False
    robot_file: RobotFile | None = None
    connect: str | None = None
    credentials: Path | None = None
    insecure: bool = False
    link: str | None = None

    @property
    def servo_map(self) -> ServoMap:
        """The servo map of the robot file's section `servos`, or the default of a robot without a file."""
        return default_servo_map() if self.robot_file is None else self.robot_file.servo_map


def make_servos(name: str, options: BackendOptions) -> LegServos:
    """Return the servos of a backend, not yet connected.

    `name` is one of `BACKENDS`, or `package.module:Class` for a LegServos of your own, which is called with
    the robot. Raises InputError for an unknown name, MissingExtraError when its extra is not installed.
    """
    if name in BACKENDS:
        return BACKENDS[name](options)
    if ":" in name:
        return _own(name, options)
    raise InputError(
        f"backend: got {name!r}; allowed: {', '.join(BACKENDS)}, "
        "or package.module:Class for your own LegServos"
    )


def _sim(options: BackendOptions) -> LegServos:
    try:
        from hexctl.backends.sim.servos import SimServos
    except ModuleNotFoundError as error:
        raise MissingExtraError("the simulation", "sim") from error
    return SimServos(
        options.robot,
        world=options.world,
        failure=options.failure,
        seed=options.seed,
        trial=options.trial,
        realtime=options.realtime,
    )


def _mock(options: BackendOptions) -> LegServos:
    from hexctl.backends.mock import MockServos

    return MockServos(options.robot)


def _zenoh(options: BackendOptions) -> LegServos:
    from hexctl.backends.zenoh.client import ZenohServos
    from hexctl.wire.links import load_link

    link = load_link(
        options.link,
        endpoint=options.connect,
        credentials=options.credentials,
        insecure=options.insecure,
    )
    return ZenohServos(options.robot, link=link)


def _mavlink(options: BackendOptions) -> LegServos:
    from hexctl.backends.mavlink.client import MavlinkServos
    from hexctl.backends.mavlink.codec import read_signing_key
    from hexctl.backends.mavlink.transport import DEFAULT_PORT, check_guarded, parse_port

    port, signing_key = options.connect or DEFAULT_PORT, read_signing_key(options.credentials)
    signed = signing_key is not None
    check_guarded(parse_port(port), option="port", text=port, signed=signed, insecure=options.insecure)
    return MavlinkServos(options.robot, servo_map=options.servo_map, port=port, signing_key=signing_key)


def _own(name: str, options: BackendOptions) -> LegServos:
    module_name, _, class_name = name.partition(":")
    try:
        made = getattr(module_here(module_name), class_name)(options.robot)
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise InputError(
            f"backend: {name!r} cannot be loaded ({error}); allowed: a LegServos class that takes the robot"
        ) from error
    if not isinstance(made, LegServos):
        raise InputError(f"backend: {name!r} made a {type(made).__name__}; allowed: a subclass of LegServos")
    return made


BACKENDS: dict[str, Callable[[BackendOptions], LegServos]] = {
    "sim": _sim,
    "zenoh": _zenoh,
    "mavlink": _mavlink,
    "mock": _mock,
}
