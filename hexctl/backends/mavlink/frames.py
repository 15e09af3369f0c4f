"""Between MAVLink's frames and ours: NED world and FRD body there, z up and y left (REP 103) here.

Both pairs share their x axis and differ by half a turn about it, so the same map leads both ways: y and z of
a vector change sign, and so do y and z of a quaternion; roll stays, pitch and yaw change sign.
"""

import math

import numpy as np

from hexctl.types import FloatArray

#: Half a turn about x, for (x, y, z).
FLIP_VECTOR = np.array([1.0, -1.0, -1.0])

#: The same for (w, x, y, z).
FLIP_QUATERNION = np.array([1.0, 1.0, -1.0, -1.0])


def flipped_vector(vector: FloatArray) -> FloatArray:
    """Return a vector (3,) of one frame in the other."""
    return np.asarray(vector * FLIP_VECTOR)


def flipped_quaternion(quaternion: FloatArray) -> FloatArray:
    """Return an orientation (w, x, y, z) of one pair of frames in the other."""
    return np.asarray(quaternion * FLIP_QUATERNION)


def quaternion_of_euler(roll_rad: float, pitch_rad: float, yaw_rad: float) -> FloatArray:
    """Return the orientation (w, x, y, z) of aerospace angles: yaw about z, then pitch, then roll."""
    cr, sr = math.cos(roll_rad / 2), math.sin(roll_rad / 2)
    cp, sp = math.cos(pitch_rad / 2), math.sin(pitch_rad / 2)
    cy, sy = math.cos(yaw_rad / 2), math.sin(yaw_rad / 2)
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def euler_of_quaternion(quaternion: FloatArray) -> tuple[float, float, float]:
    """Return roll, pitch and yaw in rad of an orientation (w, x, y, z)."""
    w, x, y, z = quaternion.tolist()
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return roll, pitch, yaw
