"""Orientations on the wire: sensor_msgs/Imu of a robot that measures its own."""

from hexctl.types import FloatArray
from hexctl.wire import ros_cdr
from hexctl.wire.pose import checked_quaternion
from hexctl.wire.ros.telemetry import IMU

#: First covariance of what is not measured (REP 145).
_NOT_MEASURED = -1.0


def decode_orientation(payload: bytes) -> FloatArray | None:
    """Unit quaternion (w, x, y, z) of a sensor_msgs/Imu, or None where it measures no orientation.

    Raises MessageError for anything else.
    """
    message = ros_cdr.decode(IMU, payload)
    if float(message.orientation_covariance[0]) == _NOT_MEASURED:
        return None
    return checked_quaternion(message.orientation)
