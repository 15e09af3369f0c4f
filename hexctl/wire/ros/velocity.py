"""Velocities that ROS 2 asks a robot for: geometry_msgs/Twist, and TwistStamped, which is newer."""

import numpy as np

from hexctl.errors import MessageError
from hexctl.types import FloatArray, all_finite
from hexctl.wire import ros_cdr

TWIST = "geometry_msgs/msg/Twist"
TWIST_STAMPED = "geometry_msgs/msg/TwistStamped"


def decode_velocity(kind: str, payload: bytes) -> FloatArray:
    """Velocity in the body's frame, (3,): forward and left in m/s, turn in rad/s.

    Stamp and frame of a TwistStamped are not looked at: clocks of computers differ, so a velocity is as old
    as its arrival, and REP 105 has velocities in `base_link`. Raises MessageError for anything else.

    Args:
        kind: `TWIST` or `TWIST_STAMPED`.
        payload: CDR.
    """
    message = ros_cdr.decode(kind, payload)
    twist = message.twist if kind == TWIST_STAMPED else message
    velocity = np.array([twist.linear.x, twist.linear.y, twist.angular.z])
    if not all_finite(velocity):
        raise MessageError(f"{kind}: got {velocity.tolist()}; allowed: finite m/s and rad/s")
    return velocity
