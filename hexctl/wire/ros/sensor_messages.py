"""ROS messages of sensor columns, for bags and for the topics of a robot."""

from typing import Any

import numpy as np

from hexctl.columns import Column
from hexctl.robot.formats.link_frames import BASE_LINK
from hexctl.types import JOINT_NAMES, FloatArray
from hexctl.wire import ros_cdr

_NONE = np.empty(0)

#: Types of messages other than arrays.
_TYPES = {
    "effort": ros_cdr.JOINT_STATE,
    "velocity": ros_cdr.JOINT_STATE,
    "twist": "geometry_msgs/msg/TwistStamped",
}


def message_type(column: Column) -> str:
    """Type of the messages of a column."""
    array = "UInt8MultiArray" if column.kind is bool else "Float64MultiArray"
    return _TYPES.get(column.message, f"std_msgs/msg/{array}")


def encode_sensor(column: Column, stamp_ns: int, values: FloatArray | float) -> bytes:
    """Message of the values of a column, 0 or 1 for truths; `stamp_ns` is nanoseconds since 1970."""
    values = np.atleast_1d(values)
    if column.message == "array":
        return ros_cdr.encode(_array(column, values))
    header = ros_cdr.header(stamp_ns, "" if column.message in ("effort", "velocity") else BASE_LINK)
    if column.message == "twist":
        content = {"twist": _twist(values)}
    else:
        fields = {"position": _NONE, "velocity": _NONE, "effort": _NONE, column.message: values}
        content = {"name": list(JOINT_NAMES), **fields}
    return ros_cdr.encode(ros_cdr.make(message_type(column), header=header, **content))


def _twist(values: FloatArray) -> Any:
    """A `Twist` of a velocity forward, to the left, and of turning."""
    forward, left, turn = values
    return ros_cdr.make(
        "geometry_msgs/msg/Twist",
        linear=ros_cdr.vector(np.array([forward, left, 0.0])),
        angular=ros_cdr.vector(np.array([0.0, 0.0, turn])),
    )


def _array(column: Column, values: FloatArray) -> Any:
    count = len(values)
    names = " ".join(column.parts)
    dimension = ros_cdr.make("std_msgs/msg/MultiArrayDimension", label=names, size=count, stride=count)
    layout = ros_cdr.make("std_msgs/msg/MultiArrayLayout", dim=[dimension], data_offset=0)
    kind = np.uint8 if column.kind is bool else np.float64
    return ros_cdr.make(message_type(column), layout=layout, data=values.astype(kind))
