"""Registry of backends: servos by name, importing only what is needed."""

import inspect
from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self

from hexctl.backends.base import LegServos
from hexctl.backends.bus.bus_map import bus_map_of, ids_mark
from hexctl.backends.pwm.pulse_board import find_board, pwm_map_of
from hexctl.errors import InputError, MissingExtraError, UnusedError, argument
from hexctl.robot.failure import Failure, FailureEvent
from hexctl.robot.loader import RobotFile
from hexctl.robot.model import Robot
from hexctl.robot.plugins import load_custom, made_by, plugin_names
from hexctl.robot.servos.drivers import BOARDS, FAMILIES, all_drivers, is_board, is_driver
from hexctl.robot.servos.raw_map import RawMap
from hexctl.robot.servos.servo_map import ServoMap, default_servo_map
from hexctl.robot.servos.servo_schema import ServosSection

if TYPE_CHECKING:
    from hexctl.backends.sim.world import World


#: Note of servos on a bus whose ids have not been compared with the legs that they move.
NOT_WALKED_THROUGH = "ids not compared with legs yet: hexctl servos walk-through --robot FILE"


@dataclass(frozen=True, slots=True, kw_only=True)
class BackendOptions:
    """Options of backends; each backend uses some of them.

    Attributes:
        trial: number of the trial; sensor noise differs between trials.
        robot_file: file of the robot, with the servo map of a real one; None without a file.
        connect: network endpoint of the robot; None for the default.
        port: of the servos or their board; None for that of the robot file, or the default.
        credentials: folder with the certificates of a link beyond loopback, or None.
        link: name or path of a link file, or None.
    """

    robot: Robot
    world: "World | None" = None
    failures: tuple[Failure, ...] = ()
    events: tuple[FailureEvent, ...] = ()
    seed: int = 0
    trial: int = 0
    realtime: bool = False
    all_sensors: bool = False
    robot_file: RobotFile | None = None
    connect: str | None = None
    port: str | None = None
    credentials: Path | None = None
    insecure: bool = False
    link: str | None = None

    @classmethod
    def of(cls, spec: object, *, robot: Robot, **others: Any) -> Self:
        """Options from the spec's attributes of the same names; `others` override them."""
        values = {**option_values(spec), "robot": robot, **others}
        if values.get("credentials") is not None:
            values["credentials"] = Path(values["credentials"])
        return cls(**values)

    @property
    def servo_map(self) -> ServoMap:
        """Servo map of the robot file's section `servos`; the default without a file."""
        return default_servo_map() if self.robot_file is None else self.robot_file.servo_map

    @property
    def servos_section(self) -> ServosSection:
        """The robot file's section `servos`; empty without a file."""
        return ServosSection() if self.robot_file is None else self.robot_file.content.servos


@dataclass(frozen=True, slots=True)
class Backend:
    """One entry of the registry: `make` returns unconnected servos.

    `takes` are the used fields of `BackendOptions`, besides the robot and its file.
    """

    make: Callable[[BackendOptions], LegServos]
    takes: frozenset[str]


def option_values(spec: object, *, but: Container[str] = ()) -> dict[str, Any]:
    """Values of a spec's backend options, by field of `BackendOptions`."""
    names = [field.name for field in fields(BackendOptions) if field.name not in but]
    return {name: getattr(spec, name) for name in names if hasattr(spec, name)}


def make_servos(name: str, options: BackendOptions) -> LegServos:
    """Servos of a backend, not yet connected.

    `name` is one of `BACKENDS`, of a plug-in, or `package.module:Class`. The class is called with the robot,
    and by keyword with the given options that it accepts: fields of `BackendOptions`, and `servo_map`. Raises
    InputError for an unknown name, MissingExtraError when its extra is not installed.
    """
    backend = find_backend(name)
    return _make_own(name, options) if backend is None else backend.make(options)


def find_backend(name: str) -> Backend | None:
    """Backend of a name, also of a plug-in's bus servos or board; None for custom servos."""
    if name not in BACKENDS and is_driver(name):
        return _driver_backend(name)
    return BACKENDS.get(name)


def has_keeper(name: str) -> bool:
    """Whether a keeper lets the robot of a backend down if its server dies."""
    return find_board(name, named=argument("backend")).has_keeper if is_board(name) else is_driver(name)


def backend_names() -> tuple[str, ...]:
    """Names of all backends, also those of plug-ins."""
    return tuple(dict.fromkeys((*BACKENDS, *all_drivers(), *plugin_names("servos"))))


def raw_map_of(file: RobotFile) -> RawMap:
    """Map of raw positions by the driver of a robot file, else its servo map; raises InputError."""
    section = file.content.servos
    if section.driver is None:
        return file.servo_map
    try:
        if is_board(section.driver):
            return pwm_map_of(section, section.driver)
        return bus_map_of(section, section.driver, file.p_gain)
    except InputError as error:
        raise InputError(f"{file.path}: {error}") from error


def check_options(
    name: str,
    *,
    names: Mapping[str, str] = MappingProxyType({}),
    but: Container[str] = (),
    **given: object,
) -> None:
    """Raise UnusedError for a given option that the backend would ignore.

    Args:
        names: the caller's names of fields, if they differ.
        but: backends that no message names.
        given: values by field of `BackendOptions`; None, False and 0 are not given.
    """
    backend = find_backend(name)
    takes = _arguments(_own_class(name)[0]) if backend is None else backend.takes
    for field, value in given.items():
        if not value or field in takes:
            continue
        takers = [known for known, each in BACKENDS.items() if field in each.takes and known not in but]
        allowed = _joined(takers)
        own = backend is None
        confused = field == "connect" and "port" in takes
        servos = f"; the port of servos is {argument('port')}" if confused else ""
        raise UnusedError(
            f"{argument(names.get(field, field))}: got {'yes' if value is True else value} "
            f"with {argument('backend')} {name}{f', whose class takes no `{field}`' if own else ''}; "
            f"allowed: with {allowed}{f', or a class that takes `{field}`' if own else ''}{servos}",
        )


def _joined(names: list[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else "".join(names) or "none"


def _sim(options: BackendOptions) -> LegServos:
    try:
        from hexctl.backends.sim.servos import SimServos
    except ModuleNotFoundError as error:
        raise MissingExtraError("the simulation", "sim") from error
    return SimServos(options.robot, **_given(options, BACKENDS["sim"].takes))


def _mock(options: BackendOptions) -> LegServos:
    from hexctl.backends.mock import MockServos

    return MockServos(options.robot)


def _zenoh(options: BackendOptions) -> LegServos:
    from hexctl.backends.zenoh.zenoh_client import ZenohServos
    from hexctl.wire.links import load_link

    link = load_link(
        options.link,
        connect=options.connect,
        credentials=options.credentials,
        insecure=options.insecure,
    )
    return ZenohServos(options.robot, link=link)


def _mavlink(options: BackendOptions) -> LegServos:
    from hexctl.backends.mavlink.codec import read_signing_key
    from hexctl.backends.mavlink.mavlink_client import MavlinkServos
    from hexctl.backends.mavlink.mavlink_transport import DEFAULT_PORT, check_guarded, parse_port

    port, signing_key = options.port or DEFAULT_PORT, read_signing_key(options.credentials)
    signed = signing_key is not None
    check_guarded(
        parse_port(port), option=argument("port"), text=port, signed=signed, insecure=options.insecure
    )
    return MavlinkServos(options.robot, servo_map=options.servo_map, port=port, signing_key=signing_key)


def _bus(options: BackendOptions, *, driver: str) -> LegServos:
    from hexctl.backends.bus.servos import BusServos
    from hexctl.backends.serial_ports import SerialAddress

    section, file = options.servos_section, options.robot_file
    p_gain = None if file is None else file.p_gain
    bus_map = bus_map_of(section, driver, p_gain, named=argument("backend"), moves=True)
    address = SerialAddress.parse(options.port or section.port, section.baud or bus_map.family.bauds[0])
    note = "" if section.walked_through == ids_mark(section) else NOT_WALKED_THROUGH
    return BusServos(options.robot, bus_map=bus_map, port=address.path, baud=address.baud, note=note)


def _board(options: BackendOptions, *, driver: str) -> LegServos:
    board, section = find_board(driver, named=argument("backend")), options.servos_section
    pwm_map = pwm_map_of(section, driver)
    port = board.parse_port(options.port or section.port, section.baud)
    return board.servos(options.robot, pwm_map=pwm_map, port=port)


def _driver_backend(driver: str) -> Backend:
    make = _board if is_board(driver) else _bus
    return Backend(partial(make, driver=driver), frozenset({"port"}))


def _make_own(name: str, options: BackendOptions) -> LegServos:
    own, label = _own_class(name)
    accepted = _arguments(own)
    given = _given(options, accepted)
    if "servo_map" in accepted:
        given["servo_map"] = options.servo_map
    return made_by(lambda: own(options.robot, **given), label, LegServos, "backend", _ALLOWED)  # type: ignore[type-abstract]


def _given(options: BackendOptions, accepted: Container[str]) -> dict[str, Any]:
    values = {field.name: getattr(options, field.name) for field in fields(options)}
    return {
        field.name: values[field.name]
        for field in fields(options)
        if field.name in accepted and values[field.name] != field.default
    }


_ALLOWED = "a LegServos class that takes the robot"


def _own_class(name: str) -> tuple[Any, str]:
    """Class of a plug-in or of `package.module:Class`, and its name for messages."""
    known = tuple(dict.fromkeys((*BACKENDS, *all_drivers())))
    return load_custom(name, "backend", known=known, allowed=_ALLOWED, door="servos")


def _arguments(own: Any) -> frozenset[str]:
    try:
        parameters = list(inspect.signature(own).parameters.values())[1:]
    except (TypeError, ValueError):
        return frozenset()
    named = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    return frozenset(parameter.name for parameter in parameters if parameter.kind in named)


BACKENDS: dict[str, Backend] = {
    "sim": Backend(
        _sim, frozenset({"world", "failures", "events", "seed", "trial", "realtime", "all_sensors"})
    ),
    "zenoh": Backend(_zenoh, frozenset({"connect", "credentials", "insecure", "link"})),
    "mavlink": Backend(_mavlink, frozenset({"port", "credentials", "insecure"})),
    **{driver: _driver_backend(driver) for driver in (*FAMILIES, *BOARDS)},
    "mock": Backend(_mock, frozenset()),
}
