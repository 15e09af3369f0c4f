"""ROS 2 messages in CDR, as ROS 2 tools expect them behind the standard Zenoh bridge."""

import struct
from functools import cache
from typing import Any

from hexctl.errors import MessageError
from hexctl.types import FloatArray
from hexctl.wire import MAX_PAYLOAD_BYTES

JOINT_STATE = "sensor_msgs/msg/JointState"
ODOMETRY = "nav_msgs/msg/Odometry"
BATTERY_STATE = "sensor_msgs/msg/BatteryState"
IMU = "sensor_msgs/msg/Imu"

NANOSECONDS = 1_000_000_000


@cache
def typestore() -> Any:
    """Types of ROS 2 Humble, from rosbags; those of hexctl's messages are equal in later distributions."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE)


def make(kind: str, **fields: Any) -> Any:
    """Message of a ROS 2 type such as `sensor_msgs/msg/JointState`."""
    return typestore().types[kind](**fields)


def declare(kind: str, definition: str) -> None:
    """Add a message type by its definition, as in a `.msg` file; types within it must be known."""
    from rosbags.typesys import get_types_from_msg

    typestore().register(get_types_from_msg(definition, kind))


def header(stamp_ns: int, frame: str = "") -> Any:
    """A std_msgs/Header; `stamp_ns` is nanoseconds since 1970."""
    seconds, rest = divmod(stamp_ns, NANOSECONDS)
    stamp = make("builtin_interfaces/msg/Time", sec=seconds & 0x7FFFFFFF, nanosec=rest)
    return make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def point(numbers: FloatArray) -> Any:
    """A geometry_msgs/Point of (3,)."""
    return make("geometry_msgs/msg/Point", **dict(zip("xyz", numbers.tolist(), strict=True)))


def vector(numbers: FloatArray) -> Any:
    """A geometry_msgs/Vector3 of (3,)."""
    return make("geometry_msgs/msg/Vector3", **dict(zip("xyz", numbers.tolist(), strict=True)))


def quaternion(numbers: FloatArray) -> Any:
    """A geometry_msgs/Quaternion of (4,): x, y, z, w."""
    return make("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", numbers.tolist(), strict=True)))


@cache
def type_hash(kind: str) -> str:
    """Hash of a message type (REP 2016), `RIHS01_` and 64 digits: distinguishes types of one name."""
    return str(typestore().hash_rihs01(kind))


def encode(message: Any) -> bytes:
    """Message as little-endian CDR with its encapsulation header."""
    return bytes(typestore().serialize_cdr(message, message.__msgtype__))


def decode(kind: str, payload: bytes) -> Any:
    """Message of a type from CDR bytes; raises MessageError for any other bytes."""
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise MessageError(f"{kind}: got {len(payload)} bytes; allowed: {MAX_PAYLOAD_BYTES} at most")
    from rosbags.serde import SerdeError

    try:
        return typestore().deserialize_cdr(payload, kind)
    except (SerdeError, ValueError, TypeError, IndexError, OverflowError, struct.error) as error:
        raise MessageError(f"{kind}: got {len(payload)} bytes that are not one ({error})") from error
