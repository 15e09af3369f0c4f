"""Commands and service calls from ROS, passed from the node's thread to the robot's."""

from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from hexctl.gait.body_pose import BodyPose
from hexctl.types import FloatArray

#: Answer of a service while driving is off.
OFF = "commands from ROS are off; start hexctl serve with --ros-drive"


class Service(Enum):
    """Services of the node."""

    STAND = "stand"
    SIT = "sit"
    CLEAR_STOP = "clear_stop"


class Call(Protocol):
    """A service call that waits for its answer."""

    def answer(self, success: bool, message: str) -> None:
        """Answer it, once."""


@dataclass(frozen=True, slots=True)
class Stopped:
    """A stop already in effect."""


@dataclass(frozen=True, slots=True, eq=False)
class WantedVelocity:
    """A velocity, (3,): forward and left in m/s, turn in rad/s."""

    velocity: FloatArray


@dataclass(frozen=True, slots=True)
class WantedPose:
    """A pose of the body over its feet."""

    pose: BodyPose


@dataclass(frozen=True, slots=True, eq=False)
class WantedJoints:
    """Joint angles, (18,), leg-major order."""

    joint_positions_rad: FloatArray


@dataclass(frozen=True, slots=True)
class Called:
    """A service call and the service that it calls."""

    service: Service
    call: Call


RosCommand = Stopped | WantedVelocity | WantedPose | WantedJoints | Called
