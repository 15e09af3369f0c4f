"""Velocity commands of ROS 2: geometry_msgs/Twist and TwistStamped."""

import numpy as np

from hexctl.errors import MessageError
from hexctl.types import FloatArray, all_finite
from hexctl.wire import ros_cdr

TWIST = "geometry_msgs/msg/Twist"
TWIST_STAMPED = "geometry_msgs/msg/TwistStamped"


def decode_velocity(kind: str, payload: bytes) -> FloatArray:
    """Velocity in the body's frame, (3,): forward and left in m/s, turn in rad/s.

    Stamp and frame of a TwistStamped are ignored: clocks of computers differ, and REP 105 has velocities in
    `base_link`. `kind` is `TWIST` or `TWIST_STAMPED`. Raises MessageError for anything else.
    """
    message = ros_cdr.decode(kind, payload)
    twist = message.twist if kind == TWIST_STAMPED else message
    velocity = np.array([twist.linear.x, twist.linear.y, twist.angular.z])
    if not all_finite(velocity):
        raise MessageError(f"{kind}: got {velocity.tolist()}; allowed: finite m/s and rad/s")
    return velocity
