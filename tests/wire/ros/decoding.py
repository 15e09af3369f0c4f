"""CDR read by a decoder of others: that of mcap-ros2-support."""

from functools import cache
from typing import Any

from mcap_ros2._dynamic import generate_dynamic
from rosbags.typesys import Stores, get_typestore


def definition(kind: str) -> str:
    """Text of a message type with all the types in it."""
    return str(get_typestore(Stores.ROS2_JAZZY).generate_msgdef(kind, ros_version=2)[0])


@cache
def _decoder(kind: str) -> Any:
    return generate_dynamic(kind, definition(kind))[kind]


def decoded(kind: str, payload: bytes) -> Any:
    """Message of a type, by an independent decoder."""
    return _decoder(kind)(payload)
