"""Poses as nav_msgs/Odometry, either half of which may be unknown, and orientations as sensor_msgs/Imu."""

import math
import time
from functools import cache
from typing import Any

import numpy as np

from hexctl.errors import MessageError
from hexctl.robot.formats.link_frames import BASE_LINK
from hexctl.robot.rotations import xyzw
from hexctl.types import FloatArray
from hexctl.wire import ros_cdr
from hexctl.wire.ros_cdr import FixedMessage

WORLD_FRAME = "odom"

#: An unknown covariance of a pose or a twist.
NO_COVARIANCE = np.zeros(36)

#: Indices of the variances of position and orientation on the diagonal of a pose's covariance.
_OF_POSITION, _OF_ORIENTATION = (0, 7, 14), (21, 28, 35)

#: First covariance of an unmeasured quantity of an Imu (REP 145).
NOT_MEASURED = -1.0

#: Variance of each unmeasured coordinate, in m^2 or rad^2.
UNKNOWN_VARIANCE = 1e6

#: A coordinate with a greater variance counts as unmeasured: a standard deviation of 30 m, or five turns.
MOST_VARIANCE = 1e3

#: Variances that decide whether a half is measured: x and y, and the yaw, as in planar odometry.
_JUDGED_POSITION, _JUDGED_ORIENTATION = [0, 7], [35]


@cache
def odometry() -> FixedMessage:
    """Encoder of a nav_msgs/Odometry: a pose in `odom`, and a twist in `base_link`.

    Its numbers, (85,): position in m, quaternion (x, y, z, w), velocity in m/s, angular velocity in rad/s,
    and the covariances of pose and twist, row by row (`NO_COVARIANCE` if unknown).
    """

    def make(stamp_ns: int, numbers: FloatArray) -> Any:
        pose = ros_cdr.make(
            "geometry_msgs/msg/Pose",
            position=ros_cdr.point(numbers[:3]),
            orientation=ros_cdr.quaternion(numbers[3:7]),
        )
        twist = ros_cdr.make(
            "geometry_msgs/msg/Twist",
            linear=ros_cdr.vector(numbers[7:10]),
            angular=ros_cdr.vector(numbers[10:13]),
        )
        kind = "geometry_msgs/msg"
        return ros_cdr.make(
            ros_cdr.ODOMETRY,
            header=ros_cdr.header(stamp_ns, WORLD_FRAME),
            child_frame_id=BASE_LINK,
            pose=ros_cdr.make(f"{kind}/PoseWithCovariance", pose=pose, covariance=numbers[13:49]),
            twist=ros_cdr.make(f"{kind}/TwistWithCovariance", twist=twist, covariance=numbers[49:]),
        )

    return FixedMessage(make, 13 + 2 * len(NO_COVARIANCE))


def encode_pose(
    position_world: FloatArray | None,
    quaternion_world: FloatArray | None,
    *,
    position_variance_m2: float = 0.0,
    yaw_variance_rad2: float | None = None,
    covariance: FloatArray | None = None,
    stamp_ns: int | None = None,
) -> bytes:
    """Pose as nav_msgs/Odometry without a twist.

    An unknown half is encoded as the origin or no rotation, with `UNKNOWN_VARIANCE`.

    Args:
        position_world: (3,) in m, or None.
        quaternion_world: (w, x, y, z), or None.
        position_variance_m2: of each coordinate; 0 for unknown.
        yaw_variance_rad2: of an orientation whose roll and pitch are not measured; None if all are.
        covariance: of a pose with both halves, (36,), in place of the variances.
        stamp_ns: nanoseconds since 1970; now unless given.
    """
    positioned, oriented = position_world is not None, quaternion_world is not None
    if covariance is not None and positioned and oriented:
        variances = covariance
    else:
        variances = _variances(positioned, oriented, position_variance_m2, yaw_variance_rad2)
    numbers = np.concatenate(
        [
            np.zeros(3) if position_world is None else position_world,
            np.array([0.0, 0.0, 0.0, 1.0]) if quaternion_world is None else xyzw(quaternion_world),
            np.zeros(6),
            variances,
            NO_COVARIANCE,
        ]
    )
    return odometry().encode(time.time_ns() if stamp_ns is None else stamp_ns, numbers)


def _variances(positioned: bool, oriented: bool, position_m2: float, yaw_rad2: float | None) -> FloatArray:
    """Covariance (36,) of a pose, row by row."""
    covariance = np.zeros(36)
    covariance[[*_OF_POSITION]] = position_m2 if positioned else UNKNOWN_VARIANCE
    if yaw_rad2 is not None or not oriented:
        covariance[[*_OF_ORIENTATION]] = UNKNOWN_VARIANCE
    if yaw_rad2 is not None and oriented:
        covariance[_JUDGED_ORIENTATION] = yaw_rad2
    return covariance


def decode_pose(payload: bytes) -> tuple[FloatArray | None, FloatArray | None]:
    """Position (3,) and unit quaternion (w, x, y, z) of a nav_msgs/Odometry, all finite.

    Each is None, and its values are ignored, unless the variances of x, y or the yaw are at most
    `MOST_VARIANCE`.
    z, roll and pitch are returned whatever their variances. Raises MessageError for anything else.
    """
    return decode_estimate(payload)[:2]


def decode_estimate(payload: bytes) -> tuple[FloatArray | None, FloatArray | None, FloatArray]:
    """Return what `decode_pose` does, and the covariance, (36,); `NO_COVARIANCE` unless it is finite."""
    estimate = ros_cdr.decode(ros_cdr.ODOMETRY, payload).pose
    pose, variances = estimate.pose, np.asarray(estimate.covariance)
    position = quaternion = None
    if (variances[_JUDGED_POSITION] <= MOST_VARIANCE).all():
        position = _checked_position(pose.position)
    if (variances[_JUDGED_ORIENTATION] <= MOST_VARIANCE).all():
        quaternion = _checked_quaternion(pose.orientation)
    return position, quaternion, variances if np.isfinite(variances).all() else NO_COVARIANCE


def decode_orientation(payload: bytes) -> FloatArray | None:
    """Unit quaternion (w, x, y, z) of a sensor_msgs/Imu, or None; raises MessageError for anything else."""
    message = ros_cdr.decode(ros_cdr.IMU, payload)
    if float(message.orientation_covariance[0]) == NOT_MEASURED:
        return None
    return _checked_quaternion(message.orientation)


def _checked_position(point: Any) -> FloatArray:
    position = np.array([point.x, point.y, point.z])
    if not np.isfinite(position).all():
        raise MessageError(f"pose: got the position {position.tolist()}; allowed: finite metres")
    return position


def _checked_quaternion(turned: Any) -> FloatArray:
    """Unit quaternion (w, x, y, z), normalized within rounding; raises MessageError for anything else."""
    quaternion = np.array([turned.w, turned.x, turned.y, turned.z])
    norm = math.hypot(*quaternion.tolist())
    if not abs(norm - 1) < 0.01:  # true for nan too
        raise MessageError(
            f"pose: got the orientation {quaternion.tolist()} (w, x, y, z); allowed: a unit quaternion"
        )
    return quaternion / norm
