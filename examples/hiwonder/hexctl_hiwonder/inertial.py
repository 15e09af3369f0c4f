"""Orientation of the body from the accelerometer and the gyroscope of the board's IMU.

The gyroscope is integrated, and the measured vertical corrects the tilt slowly (complementary filter: Mahony,
Hamel and Pflimlin 2008, https://doi.org/10.1109/TAC.2008.923738). The yaw drifts with what is left of the
gyroscope's offset, which is measured while the robot is still.
"""

from collections import deque

import numpy as np

from hexctl.robot.rotations import inverse, product, quaternion_about, turned
from hexctl.types import FloatArray

#: Samples without motion from which the offset is taken: about a second.
STILL_SAMPLES = 100

#: Maximum range of each axis in them: the noise of an MPU-6050 has 0.05 degrees per second RMS.
STILL_DEG_S = 1.0

#: Maximum offset of the gyroscope: its data sheet allows 20 degrees per second.
MOST_OFFSET_DEG_S = 20.0

#: How far a measured acceleration may be from gravity to count as the vertical, in g.
NEAR_G = 0.1

#: Share of a wrong tilt that is corrected in a second.
CORRECTED_PER_S = 0.5

#: Samples of which the median counts: packets with damage that their checksum does not show are rare.
MEDIAN_OF = 3

#: Longest time without a report over which the last rate is assumed.
LONGEST_S = 0.2

UP = np.array([0.0, 0.0, 1.0])


class Inertial:
    """Orientation of a body whose IMU has x forward and z up, as both are on a SpiderPi.

    Attributes:
        quaternion: (w, x, y, z), (4,), with the yaw from zero; None until the robot was still for a second,
            and if the IMU is upside down or on its side then.
        angular_velocity_rad_s: about its own axes, (3,), without the offset; None as well.
    """

    def __init__(self) -> None:
        self._recent: deque[FloatArray] = deque(maxlen=STILL_SAMPLES)
        self._offset_deg_s: FloatArray | None = None
        self._at_s = -np.inf
        self.quaternion: FloatArray | None = None
        self.angular_velocity_rad_s: FloatArray | None = None

    def take(self, samples: FloatArray, at_s: float) -> None:
        """Take samples of acceleration in g and rate in degrees per second, (n, 6), up to a time."""
        self._recent.extend(samples)
        newest = list(self._recent)[-max(MEDIAN_OF, len(samples)) :]
        acceleration, rate_deg_s = np.split(np.median(newest, axis=0), 2)
        self._measure_offset()
        duration_s, self._at_s = at_s - self._at_s, at_s
        if self._offset_deg_s is None:
            return
        if self.quaternion is None or duration_s > LONGEST_S:
            self._begin(np.mean(self._recent, axis=0)[:3])
            return
        rate = np.radians(rate_deg_s - self._offset_deg_s)
        size = float(np.linalg.norm(acceleration))
        correction = np.zeros(3)
        if abs(size - 1) < NEAR_G:
            up = turned(inverse(self.quaternion), UP)
            correction = CORRECTED_PER_S * np.cross(acceleration / size, up)
        self.angular_velocity_rad_s = rate
        self.quaternion = _integrated(self.quaternion, rate + correction, duration_s)

    def _measure_offset(self) -> None:
        """Take the mean rate as the offset while nothing moves."""
        if len(self._recent) < STILL_SAMPLES:
            return
        recent = np.array(self._recent)
        offset = recent[:, 3:].mean(axis=0)
        still = np.ptp(recent[:, 3:], axis=0).max() < STILL_DEG_S
        level = abs(np.linalg.norm(recent[:, :3].mean(axis=0)) - 1) < NEAR_G
        if still and level and np.abs(offset).max() <= MOST_OFFSET_DEG_S:
            self._offset_deg_s = offset

    def _begin(self, acceleration: FloatArray) -> None:
        """Begin level with the measured vertical; not if the IMU leans by more than 60 degrees."""
        up = acceleration / np.linalg.norm(acceleration)
        if up[2] < 0.5:
            self.quaternion = self.angular_velocity_rad_s = None
            return
        axis = np.cross(up, UP)
        sin = float(np.linalg.norm(axis))
        yaw = self.quaternion if self.quaternion is not None else np.array([1.0, 0.0, 0.0, 0.0])
        tilt = quaternion_about(axis / sin, np.arcsin(sin)) if sin > 0 else np.array([1.0, 0.0, 0.0, 0.0])
        heading = np.array([yaw[0], 0.0, 0.0, yaw[3]])
        self.quaternion = product(heading / np.linalg.norm(heading), tilt)


def _integrated(quaternion: FloatArray, rate_rad_s: FloatArray, duration_s: float) -> FloatArray:
    angle = float(np.linalg.norm(rate_rad_s)) * duration_s
    if angle == 0.0:
        return quaternion
    turned_by = product(quaternion, quaternion_about(rate_rad_s / np.linalg.norm(rate_rad_s), angle))
    return np.asarray(turned_by / np.linalg.norm(turned_by))
