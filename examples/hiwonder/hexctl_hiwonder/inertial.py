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

UP, TINY = np.array([0.0, 0.0, 1.0]), 1e-12


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
        duration_s, self._at_s = min(at_s - self._at_s, LONGEST_S), at_s
        if self._offset_deg_s is None:
            return
        if self.quaternion is None:
            self._begin(np.mean(self._recent, axis=0)[:3])
            return
        self.angular_velocity_rad_s = rate = np.radians(rate_deg_s - self._offset_deg_s)
        size = float(np.linalg.norm(acceleration))
        if abs(size - 1) < NEAR_G:
            up = turned(inverse(self.quaternion), UP)
            rate = rate + CORRECTED_PER_S * np.cross(acceleration / size, up)
        self.quaternion = product(self.quaternion, _turn(rate * duration_s))

    def _measure_offset(self) -> None:
        rates = np.array(self._recent)[:, 3:]
        offset, still = rates.mean(axis=0), np.ptp(rates, axis=0).max() < STILL_DEG_S
        if len(rates) == STILL_SAMPLES and still and np.abs(offset).max() <= MOST_OFFSET_DEG_S:
            self._offset_deg_s = offset

    def _begin(self, acceleration: FloatArray) -> None:
        """Begin level with the measured vertical; not if the IMU leans by more than 60 degrees."""
        up = acceleration / np.linalg.norm(acceleration)
        axis = np.cross(up, UP)
        if up[2] > 0.5:
            sin = float(np.linalg.norm(axis))
            self.quaternion = _turn(axis / max(sin, TINY) * np.arcsin(sin))


def _turn(angles_rad: FloatArray) -> FloatArray:
    """Quaternion (4,) of a turn about an axis, with the angle as its length."""
    angle_rad = float(np.linalg.norm(angles_rad))
    return quaternion_about(angles_rad / max(angle_rad, TINY), angle_rad)
