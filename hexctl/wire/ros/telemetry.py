"""ROS 2 messages that a robot sends: odometry, transforms, orientation, diagnostics, texts and answers."""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cache
from typing import Any

import numpy as np

from hexctl.robot.formats.link_frames import BASE_LINK
from hexctl.robot.rotations import xyzw
from hexctl.types import FloatArray
from hexctl.wire import ros_cdr
from hexctl.wire.pose import NOT_MEASURED
from hexctl.wire.ros_cdr import FixedMessage

STRING = "std_msgs/msg/String"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"

#: Numbers of a transform: x, y, z in m and a quaternion (x, y, z, w) as in ROS.
TRANSFORM_NUMBERS = 7


def transforms(frames: Sequence[tuple[str, str]]) -> FixedMessage:
    """Encoder of a tf2_msgs/TFMessage of (parent, child) frames; its numbers are the transforms in a row."""

    def make(stamp_ns: int, numbers: FloatArray) -> Any:
        rows = numbers.reshape(-1, TRANSFORM_NUMBERS)
        return ros_cdr.make(
            TRANSFORMS,
            transforms=[
                ros_cdr.make(
                    "geometry_msgs/msg/TransformStamped",
                    header=ros_cdr.header(stamp_ns, parent),
                    child_frame_id=child,
                    transform=ros_cdr.make(
                        "geometry_msgs/msg/Transform",
                        translation=ros_cdr.vector(row[:3]),
                        rotation=ros_cdr.quaternion(row[3:]),
                    ),
                )
                for (parent, child), row in zip(frames, rows, strict=True)
            ],
        )

    return FixedMessage(make, TRANSFORM_NUMBERS * len(frames))


@cache
def _imu() -> FixedMessage:
    """Encoder of a sensor_msgs/Imu: a quaternion (x, y, z, w), a rate, and their first covariances."""

    def make(stamp_ns: int, numbers: FloatArray) -> Any:
        return ros_cdr.make(
            ros_cdr.IMU,
            header=ros_cdr.header(stamp_ns, BASE_LINK),
            orientation=ros_cdr.quaternion(numbers[:4]),
            orientation_covariance=np.append(numbers[7], np.zeros(8)),
            angular_velocity=ros_cdr.vector(numbers[4:7]),
            angular_velocity_covariance=np.append(numbers[8], np.zeros(8)),
            linear_acceleration=ros_cdr.vector(np.zeros(3)),
            linear_acceleration_covariance=np.append(NOT_MEASURED, np.zeros(8)),
        )

    return FixedMessage(make, 9)


def encode_imu(stamp_ns: int, quaternion: FloatArray | None, rate_rad_s: FloatArray | None = None) -> bytes:
    """Orientation (w, x, y, z) and angular velocity about the axes of the body, (3,), as sensor_msgs/Imu.

    Covariances are 0 (unknown), or -1 if the value is None (REP 145).
    """
    turn = (0.0, 0.0, 0.0, 1.0) if quaternion is None else xyzw(quaternion)
    rate = np.zeros(3) if rate_rad_s is None else rate_rad_s
    known = [NOT_MEASURED if one is None else 0.0 for one in (quaternion, rate_rad_s)]
    return _imu().encode(stamp_ns, np.concatenate([turn, rate, known]))


def encode_string(text: str) -> bytes:
    """Text as std_msgs/String."""
    return ros_cdr.encode(ros_cdr.make(STRING, data=text))


class Level(IntEnum):
    """Levels of a diagnostic status."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True, slots=True)
class DiagnosticStatus:
    """Status of one part of a robot: a line, and measured values as text."""

    level: Level
    name: str
    message: str
    values: Mapping[str, str] = field(default_factory=dict)


def encode_diagnostics(statuses: Sequence[DiagnosticStatus], hardware: str, stamp_ns: int) -> bytes:
    """Statuses as diagnostic_msgs/DiagnosticArray; `hardware` is the robot's name."""
    return ros_cdr.encode(
        ros_cdr.make(
            DIAGNOSTICS,
            header=ros_cdr.header(stamp_ns),
            status=[
                ros_cdr.make(
                    "diagnostic_msgs/msg/DiagnosticStatus",
                    level=int(one.level),
                    name=one.name,
                    message=one.message,
                    hardware_id=hardware,
                    values=[
                        ros_cdr.make("diagnostic_msgs/msg/KeyValue", key=key, value=value)
                        for key, value in one.values.items()
                    ],
                )
                for one in statuses
            ],
        )
    )


def encode_trigger_answer(success: bool, message: str) -> bytes:
    """Answer of a std_srvs/Trigger: encapsulation, a flag, and a text aligned to 4 bytes."""
    text = message.encode() + b"\0"
    return b"\0\1\0\0" + struct.pack("<B3xI", success, len(text)) + text
