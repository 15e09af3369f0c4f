"""Settings of a served robot that ROS may read and set, by the six parameter services of its node."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
import zenoh

from hexctl.errors import HexctlError, InputError, MessageError
from hexctl.gait.gait import DEFAULT_GAIT, Gait, gait_text, make_gait
from hexctl.options import Option, Typed, check_fields, options_of
from hexctl.robot.model import Robot
from hexctl.server.idle import SIT_AFTER_RANGE_S, SIT_AFTER_S
from hexctl.wire.ros import parameters
from hexctl.wire.ros.motion_commands import OFF
from hexctl.wire.ros.parameters import ParameterService, ParameterType, Value, descriptor_message, value_in
from hexctl.wire.ros.ros_names import Kind, Qos, RosEndpoint, RosNode
from hexctl.wire.ros.ros_session import RosRequest, RosService

#: Name of the setting that every ROS node has.
SIM_TIME = "use_sim_time"

#: Why the fixed settings are fixed.
_FIXED = {
    SIM_TIME: "stamps are the computer's clock, of a simulation too",
    "ros_drive": "it is given at the start: hexctl serve --ros-drive",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class RosSettings:
    """Parameters of the node, with the ranges of the options of `hexctl serve` and `hexctl drive`.

    Raises InputError for an invalid value.
    """

    sit_after_s: Annotated[float, SIT_AFTER_RANGE_S] = SIT_AFTER_S
    """Seconds without a command until the robot sits and relaxes, {}."""

    gait: Annotated[str, Typed(parse=gait_text)] = DEFAULT_GAIT
    """Gait of velocities: demo, tripod, wave, ripple; a code, 1..720; or six slots such as 5,1,2,4,3,6. It
    changes in stride.
    """

    level: bool = False
    """Whether the body is kept level on slopes, by its measured roll and pitch."""

    ros_drive: bool = False
    """Whether ROS may move the robot, and set parameters."""

    use_sim_time: bool = False
    """Whether stamps are simulated time."""

    def __post_init__(self) -> None:
        check_fields(self)
        object.__setattr__(self, "gait", gait_text(self.gait))

    def gait_of(self, robot: Robot) -> Gait:
        """Gait of the walk; raises InputError unless it is a gait of the robot."""
        return make_gait(robot, self.gait)


class LiveSettings:
    """The settings in force; read from any thread, set by the node's.

    Attributes:
        now: replaced as a whole; the robot's thread applies it in its next control period.
    """

    def __init__(self, robot: Robot, settings: RosSettings) -> None:
        self._robot = robot
        self.now = settings
        self._options = {one.flag.replace("-", "_"): one for one in options_of(RosSettings)}

    def names(self, prefixes: Sequence[str] = ()) -> list[str]:
        """Names, sorted, of all settings or of those under prefixes: none contains a dot."""
        return sorted(name for name in self._options if not prefixes or name in prefixes)

    def value(self, name: str) -> Value | None:
        """Value of a setting; None for an unknown name."""
        option = self._options.get(name)
        if option is None:
            return None
        value: Value = getattr(self.now, option.name)
        return value

    def descriptor(self, name: str) -> Any:
        """Description of a setting as a message; None for an unknown name."""
        option = self._options.get(name)
        if option is None:
            return None
        fixed = not self.now.ros_drive or name in _FIXED
        return descriptor_message(name, _type_of(option), option.text, option.range, read_only=fixed)

    def set(self, wishes: Sequence[Any]) -> str:
        """Set all values of rcl_interfaces/Parameter messages, or none; return why not, or an empty text.

        The reasons are in the words of rclcpp and rclpy.
        """
        try:
            self.now = self._changed(wishes)
        except HexctlError as error:
            return str(error)
        return ""

    def _changed(self, wishes: Sequence[Any]) -> RosSettings:
        changes: dict[str, Any] = {}
        for wish in wishes:
            option, value = self._checked(wish.name, int(wish.value.type)), value_in(wish.value)
            if option.range is not None:
                option.range.check(wish.name, float(value or 0))
            changes[option.name] = value
        changed = replace(self.now, **changes)
        changed.gait_of(self._robot)
        return changed

    def _checked(self, name: str, code: int) -> Option:
        """Option of an assignment; raises InputError for an unknown or fixed one and for another type."""
        option = self._options.get(name)
        if option is None:
            known = ", ".join(self.names())
            raise InputError(
                f"parameter '{name}' cannot be set because it was not declared; allowed: {known}"
            )
        fixed = _FIXED.get(name, None if self.now.ros_drive else OFF)
        if fixed is not None:
            raise InputError(f"parameter '{name}' cannot be set because it is read-only: {fixed}")
        kind = _type_of(option)
        if code != kind:
            hint = " Write a point: 30.0." if kind is ParameterType.DOUBLE else ""
            raise InputError(
                f"Wrong parameter type, parameter {{{name}}} is of type {{{kind.words}}}, setting it to "
                f"{{{_words(code)}}} is not allowed.{hint}"
            )
        return option


def _type_of(option: Option) -> ParameterType:
    return ParameterType.of(option.default)


def _words(code: int) -> str:
    known = code in ParameterType.__members__.values()
    return ParameterType(code).words if known else f"unknown type {code}"


#: Number of the first endpoint of the node.
FIRST = 50

#: That of parameters in every node (rmw_qos_profile_parameters).
QOS = Qos(depth=1000)


class ParameterServices:
    """The services on an open session."""

    def __init__(self, session: zenoh.Session, node: RosNode, live: LiveSettings) -> None:
        self._live = live
        self._services = {
            service: RosService(session, parameter_endpoint(node, service)) for service in ParameterService
        }

    def answer(self) -> int:
        """Answer a request of each service; return the number of malformed ones, which get no answer."""
        malformed = 0
        for service, server in self._services.items():
            request = server.next_request()
            malformed += server.take_malformed()
            if request is not None:
                malformed += not self._answered(service, request)
        return malformed

    def _answered(self, service: ParameterService, request: RosRequest) -> bool:
        try:
            asked = parameters.decode_request(service, request.payload)
        except MessageError:
            request.refuse()
            return False
        request.answer(parameters.encode_answer(service, content(self._live, service, asked)))
        return True


def parameter_endpoint(node: RosNode, service: ParameterService) -> RosEndpoint:
    """Endpoint of a parameter service."""
    number = FIRST + list(ParameterService).index(service)
    return RosEndpoint(node, Kind.SERVICE, f"~/{service.value}", service.kind, number, QOS)


def content(live: LiveSettings, service: ParameterService, asked: Any) -> Any:
    """Content of an answer. As in rclcpp and rclpy, one unknown name empties the whole list."""
    if service is ParameterService.SET:
        return [parameters.result_message(live.set([wish])) for wish in asked.parameters]
    if service is ParameterService.SET_ATOMICALLY:
        return parameters.result_message(live.set(asked.parameters))
    if service is ParameterService.LIST:
        return parameters.names_message(live.names(asked.prefixes))
    read = live.descriptor if service is ParameterService.DESCRIBE else live.value
    found: list[Any] = [read(name) for name in asked.names]
    found = [] if None in found else found
    if service is ParameterService.GET:
        return [parameters.value_message(value) for value in found]
    if service is ParameterService.GET_TYPES:
        return np.array([ParameterType.of(value) for value in found], dtype=np.uint8)
    return found
