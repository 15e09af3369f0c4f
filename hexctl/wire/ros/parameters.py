"""Parameter services of a ROS 2 node: requests, answers and values of rcl_interfaces in CDR."""

from collections.abc import Sequence
from enum import Enum, IntEnum
from functools import cache
from typing import Any

import numpy as np

from hexctl.options import Range
from hexctl.wire import ros_cdr

#: Value of a parameter of this node: no setting is a list.
Value = bool | int | float | str

_MESSAGES = "rcl_interfaces/msg"


class ParameterService(Enum):
    """Services that `ros2 param`, launch files and rqt call; clients wait for all six."""

    DESCRIBE = "describe_parameters"
    GET = "get_parameters"
    GET_TYPES = "get_parameter_types"
    LIST = "list_parameters"
    SET = "set_parameters"
    SET_ATOMICALLY = "set_parameters_atomically"

    @property
    def kind(self) -> str:
        """Type of the service: `rcl_interfaces/srv/GetParameters`."""
        return f"rcl_interfaces/srv/{self.value.title().replace('_', '')}"


#: Request and answer of each service, as its `.srv` file defines them.
DEFINITIONS = {
    ParameterService.DESCRIBE: ("string[] names", f"{_MESSAGES}/ParameterDescriptor[] descriptors"),
    ParameterService.GET: ("string[] names", f"{_MESSAGES}/ParameterValue[] values"),
    ParameterService.GET_TYPES: ("string[] names", "uint8[] types"),
    ParameterService.LIST: (
        "string[] prefixes\nuint64 depth",
        f"{_MESSAGES}/ListParametersResult result",
    ),
    ParameterService.SET: (
        f"{_MESSAGES}/Parameter[] parameters",
        f"{_MESSAGES}/SetParametersResult[] results",
    ),
    ParameterService.SET_ATOMICALLY: (
        f"{_MESSAGES}/Parameter[] parameters",
        f"{_MESSAGES}/SetParametersResult result",
    ),
}


class ParameterType(IntEnum):
    """Types of rcl_interfaces/ParameterType."""

    NOT_SET = 0
    BOOL = 1
    INTEGER = 2
    DOUBLE = 3
    STRING = 4
    BYTE_ARRAY = 5
    BOOL_ARRAY = 6
    INTEGER_ARRAY = 7
    DOUBLE_ARRAY = 8
    STRING_ARRAY = 9

    @classmethod
    def of(cls, value: Value) -> "ParameterType":
        """Type of a value."""
        kinds = {bool: cls.BOOL, int: cls.INTEGER, float: cls.DOUBLE, str: cls.STRING}
        return kinds[type(value)]

    @property
    def words(self) -> str:
        """Name in messages, as rclcpp prints it: `integer_array`, `not set`."""
        return "not set" if self is ParameterType.NOT_SET else self.name.lower()


@cache
def request_and_answer(service: ParameterService) -> tuple[str, str]:
    """Names under which the codec knows the messages of a service; it knows no services."""
    message = service.kind.replace("/srv/", "/msg/")
    names = (f"{message}_Request", f"{message}_Response")
    for name, definition in zip(names, DEFINITIONS[service], strict=True):
        ros_cdr.declare(name, definition)
    return names


def decode_request(service: ParameterService, payload: bytes) -> Any:
    """Request with the fields of its definition; raises MessageError for anything else."""
    return ros_cdr.decode(request_and_answer(service)[0], payload)


def encode_answer(service: ParameterService, content: Any) -> bytes:
    """Answer whose only field has this content."""
    field = DEFINITIONS[service][1].rpartition(" ")[2]
    return ros_cdr.encode(ros_cdr.make(request_and_answer(service)[1], **{field: content}))


def value_message(value: Value) -> Any:
    """A rcl_interfaces/ParameterValue."""
    kind = ParameterType.of(value)
    return ros_cdr.make(
        f"{_MESSAGES}/ParameterValue",
        type=int(kind),
        bool_value=value if kind is ParameterType.BOOL else False,
        integer_value=value if kind is ParameterType.INTEGER else 0,
        double_value=value if kind is ParameterType.DOUBLE else 0.0,
        string_value=value if kind is ParameterType.STRING else "",
        byte_array_value=np.empty(0, dtype=np.uint8),
        bool_array_value=np.empty(0, dtype=np.bool_),
        integer_array_value=np.empty(0, dtype=np.int64),
        double_array_value=np.empty(0),
        string_array_value=[],
    )


def value_in(message: Any) -> Value | None:
    """Value of a rcl_interfaces/ParameterValue; None for a type that no parameter of this node has."""
    values: dict[int, Value] = {
        ParameterType.BOOL: bool(message.bool_value),
        ParameterType.INTEGER: int(message.integer_value),
        ParameterType.DOUBLE: float(message.double_value),
        ParameterType.STRING: str(message.string_value),
    }
    return values.get(int(message.type))


def result_message(reason: str) -> Any:
    """A rcl_interfaces/SetParametersResult; an empty reason is a success."""
    return ros_cdr.make(f"{_MESSAGES}/SetParametersResult", successful=not reason, reason=reason)


def names_message(names: Sequence[str]) -> Any:
    """A rcl_interfaces/ListParametersResult without prefixes."""
    return ros_cdr.make(f"{_MESSAGES}/ListParametersResult", names=list(names), prefixes=[])


def descriptor_message(
    name: str, kind: ParameterType, description: str, allowed: Range | None, *, read_only: bool
) -> Any:
    """A rcl_interfaces/ParameterDescriptor, as `ros2 param describe` prints it."""
    ranges = []
    if allowed is not None:
        bounds = {"from_value": allowed.low, "to_value": allowed.high, "step": 0.0}
        ranges.append(ros_cdr.make(f"{_MESSAGES}/FloatingPointRange", **bounds))
    return ros_cdr.make(
        f"{_MESSAGES}/ParameterDescriptor",
        name=name,
        type=int(kind),
        description=description,
        additional_constraints="",
        read_only=read_only,
        dynamic_typing=False,
        floating_point_range=ranges,
        integer_range=[],
    )
