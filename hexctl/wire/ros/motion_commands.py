"""Commands from ROS 2: velocities as Twist and TwistStamped, body poses as Pose (as of champ), services."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from hexctl.errors import InputError, MessageError
from hexctl.gait.body_pose import BodyPose
from hexctl.robot.rotations import roll_pitch_rad, yaw_rad
from hexctl.types import FloatArray, all_finite
from hexctl.wire import ros_cdr

TWIST = "geometry_msgs/msg/Twist"
TWIST_STAMPED = "geometry_msgs/msg/TwistStamped"
POSE = "geometry_msgs/msg/Pose"

#: Allowed error of the length of a quaternion.
LENGTH_ERROR = 0.01


#: Answer of a service while driving is off.
OFF = "commands from ROS are off; start hexctl serve with --ros-drive"


class Service(Enum):
    """Services of the node."""

    STAND = "stand"
    SIT = "sit"
    CLEAR_STOP = "clear_stop"


@dataclass(frozen=True, slots=True, eq=False)
class WantedVelocity:
    """A velocity, (3,): forward and left in m/s, turn in rad/s."""

    velocity: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class WantedJoints:
    """Joint angles, (18,), leg-major order."""

    joint_positions_rad: FloatArray


@dataclass(frozen=True, slots=True)
class Called:
    """A service call; `answer` takes a flag and a line, once."""

    service: Service
    answer: Callable[[bool, str], None]


RosCommand = WantedVelocity | BodyPose | WantedJoints | Called


def decode_velocity(kind: str, payload: bytes) -> FloatArray:
    """Velocity in the body's frame, (3,): forward and left in m/s, turn in rad/s.

    The frame of a TwistStamped is ignored, because REP 105 has velocities in `base_link`. `kind` is `TWIST`
    or `TWIST_STAMPED`. Raises MessageError for anything else.
    """
    message = ros_cdr.decode(kind, payload)
    twist = message.twist if kind == TWIST_STAMPED else message
    velocity = np.array([twist.linear.x, twist.linear.y, twist.angular.z])
    if not all_finite(velocity):
        raise MessageError(f"{kind}: got {velocity.tolist()}; allowed: finite m/s and rad/s")
    return velocity


def decode_body_pose(payload: bytes) -> BodyPose:
    """Pose of the body relative to where its gait carries it.

    A quaternion of zeros, as of a message without an orientation, is no rotation. Raises MessageError for
    anything else than a finite pose within the ranges of `BodyPose`.
    """
    message = ros_cdr.decode(POSE, payload)
    at, turn = message.position, message.orientation
    numbers = np.array([turn.x, turn.y, turn.z, turn.w, at.x, at.y, at.z])
    if not all_finite(numbers):
        raise MessageError(f"body_pose: got {numbers.tolist()}; allowed: finite m and a quaternion")
    x, y, z, w = (numbers[:4] if numbers[:4].any() else np.array([0.0, 0.0, 0.0, 1.0])).tolist()
    length = math.hypot(x, y, z, w)
    if abs(length - 1) > LENGTH_ERROR:
        raise MessageError(f"body_pose: got a quaternion of length {length:.3g}; allowed: 1")
    quaternion = np.array([w, x, y, z])
    roll_rad, pitch_rad = roll_pitch_rad(quaternion)
    try:
        return BodyPose(
            roll_rad=float(roll_rad),
            pitch_rad=float(pitch_rad),
            yaw_rad=float(yaw_rad(quaternion)),
            forward_m=float(at.x),
            left_m=float(at.y),
            up_m=float(at.z),
        )
    except InputError as error:
        raise MessageError(f"body_pose: {error}") from error
