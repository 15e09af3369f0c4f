"""Extended Kalman filter of a robot's pose on the floor, its slip and its velocity.

With the position p (complex, in the floor's frame), the yaw psi, and a motion m = forward + i left and a turn
t by the robot's own odometry, a step is

    p'   = p + exp(i psi) (1 + s) m,    psi' = psi + (1 + s_t) t + s_d |m|

The state includes the slip. The real part of s is the lost share of the distance, its imaginary part the
drift to the left. s_t is the lost share of a turn, and s_d a turn per metre. Slip depends on feet, floor and
failed legs and changes slowly, so it bridges gaps better than plain odometry. Without odometry the body
coasts with a decaying velocity.
"""

import cmath
import math
from dataclasses import dataclass, replace

import numpy as np

from hexctl.robot.rotations import wrapped_rad
from hexctl.types import ArrayFields, FloatArray
from hexctl.vision.detection.planar_pose import PlanarPose

#: Parts of the state: pose (x, y in m, yaw in rad), slip (share ahead, share to the left, share of a turn,
#: turn in rad/m), velocity of the body (forward, left in m/s, turn in rad/s).
POSE, SLIP, VELOCITY = slice(0, 3), slice(3, 7), slice(7, 10)
STATES = 10

#: Initial standard deviations of slip and velocity.
FIRST_SLIP = np.array([0.2, 0.15, 0.2, 0.4])
FIRST_VELOCITY = np.array([0.15, 0.15, 0.5])

#: Random errors of odometry in m and rad, per square root of a metre, of a rad and of a second.
PER_METRE = np.array([0.02, 0.02, 0.1])
PER_RAD = np.array([0.005, 0.005, 0.05])
PER_SECOND = np.array([0.002, 0.002, 0.004])

#: The same of a yaw that the robot measured.
MEASURED_PER_SECOND_RAD = 0.003

#: How slip changes, for each root of a metre, and of a rad.
SLIP_PER_METRE = np.array([0.15, 0.15, 0.0, 0.4])
SLIP_PER_RAD = np.array([0.0, 0.0, 0.15, 0.0])

#: How the velocity of a coasting body changes, for each root of a second.
VELOCITY_PER_SECOND = np.array([0.3, 0.3, 1.5])

#: Minimum duration of a step of odometry. Two messages can arrive almost together, and the velocity would
#: otherwise explode.
LEAST_S = 0.02

#: Averaging time of the velocity from odometry.
VELOCITY_S = 0.06

#: Sightings are never believed to be better than this: a body that sways carries its tag along.
LEAST_SIGMA = np.array([0.003, 0.003, math.radians(0.2)])


@dataclass(frozen=True, slots=True, eq=False)
class OwnMotion(ArrayFields):
    """A motion as the robot itself has measured it.

    Attributes:
        from_s: when it began.
        to_s: when it ended.
        motion: in the body's frame at the beginning, (3,): forward and left in m, counter-clockwise in rad.
        yaw_measured: whether the turn is that of a sensor, and not of the feet.
    """

    from_s: float
    to_s: float
    motion: FloatArray
    yaw_measured: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Sighting(ArrayFields):
    """A pose as it was seen.

    Attributes:
        at_s: when the picture was taken, not when it came.
        pose: of the body in the floor's frame.
        covariance: of x, y in m and yaw in rad, (3, 3).
    """

    at_s: float
    pose: PlanarPose
    covariance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PoseBelief(ArrayFields):
    """Mean and covariance of the state at a time.

    Attributes:
        at_s: the time.
        mean: (10,), see `POSE`, `SLIP`, `VELOCITY`; the yaw is not wrapped.
        covariance: (10, 10).
    """

    at_s: float
    mean: FloatArray
    covariance: FloatArray

    @classmethod
    def of(cls, sighting: Sighting, slip_of: "PoseBelief | None" = None) -> "PoseBelief":
        """Belief after a first sighting; the slip may be that of a belief before."""
        mean = np.zeros(STATES)
        mean[POSE] = sighting.pose.x_m, sighting.pose.y_m, sighting.pose.yaw_rad
        covariance = np.zeros((STATES, STATES))
        covariance[POSE, POSE] = _noise(sighting)
        covariance[VELOCITY, VELOCITY] = np.diag(FIRST_VELOCITY**2)
        covariance[SLIP, SLIP] = np.diag(FIRST_SLIP**2)
        if slip_of is not None:
            mean[SLIP], covariance[SLIP, SLIP] = slip_of.mean[SLIP], slip_of.covariance[SLIP, SLIP]
        return cls(sighting.at_s, mean, covariance)

    @property
    def pose(self) -> PlanarPose:
        """Mean of the pose."""
        x_m, y_m, yaw_rad = self.mean[POSE].tolist()
        return PlanarPose(x_m, y_m, wrapped_rad(yaw_rad))

    def moved(self, own: OwnMotion, to_s: float) -> "PoseBelief":
        """After the part of a motion between the time of this belief, or its beginning, and a time."""
        end_s, sure = min(to_s, own.to_s), own.yaw_measured
        took_s = end_s - max(self.at_s, own.from_s)
        forward_m, left_m, turn_rad = (own.motion * (took_s / (own.to_s - own.from_s))).tolist()
        ahead = complex(forward_m, left_m)
        mean, distance_m = self.mean.copy(), abs(ahead)
        facing = cmath.exp(1j * mean[2])
        level = facing * ahead
        way = level * complex(1 + mean[3], mean[4])
        turned_rad = turn_rad if sure else turn_rad * (1 + mean[5]) + distance_m * mean[6]
        mean[0] += way.real
        mean[1] += way.imag
        mean[2] += turned_rad
        step = np.eye(STATES)
        step[:2, 2] = -way.imag, way.real
        step[:2, 3] = level.real, level.imag
        step[:2, 4] = -level.imag, level.real
        if not sure:
            step[2, 5], step[2, 6] = turn_rad, distance_m
        # One step of odometry may be off by its own length, where the weight goes from feet to feet.
        ahead_now = facing.conjugate() * way
        now = np.array([ahead_now.real, ahead_now.imag, turned_rad]) / max(took_s, LEAST_S)
        kept = math.exp(-took_s / VELOCITY_S)
        mean[VELOCITY] = kept * mean[VELOCITY] + (1 - kept) * now
        step[VELOCITY, VELOCITY] = 0.0
        covariance = step @ self.covariance @ step.T
        noise = np.zeros(STATES)
        noise[POSE] = PER_METRE**2 * distance_m + PER_RAD**2 * abs(turn_rad) + PER_SECOND**2 * took_s
        if sure:
            noise[2] = MEASURED_PER_SECOND_RAD**2 * took_s
        noise[SLIP] = SLIP_PER_METRE**2 * distance_m + SLIP_PER_RAD**2 * abs(turn_rad)
        covariance[np.diag_indices(STATES)] += noise
        return PoseBelief(end_s, mean, covariance)

    def coasted(self, to_s: float, dying_s: float) -> "PoseBelief":
        """At a time until which nothing was measured: the velocity dies away with a time constant."""
        took_s = to_s - self.at_s
        left = math.exp(-took_s / dying_s)
        worth_s = dying_s * (1 - left)
        mean = self.mean.copy()
        facing = cmath.exp(1j * mean[2])
        way = facing * complex(mean[7], mean[8]) * worth_s
        mean[0] += way.real
        mean[1] += way.imag
        mean[2] += mean[9] * worth_s
        mean[VELOCITY] *= left
        step = np.eye(STATES)
        step[:2, 2] = -way.imag, way.real
        step[0, 7:9] = facing.real * worth_s, -facing.imag * worth_s
        step[1, 7:9] = facing.imag * worth_s, facing.real * worth_s
        step[2, 9] = worth_s
        step[VELOCITY, VELOCITY] *= left
        covariance = step @ self.covariance @ step.T
        noise = np.zeros(STATES)
        noise[POSE] = PER_SECOND**2 * took_s
        noise[VELOCITY] = VELOCITY_PER_SECOND**2 * took_s
        covariance[np.diag_indices(STATES)] += noise
        return PoseBelief(to_s, mean, covariance)

    def surprise(self, sighting: Sighting) -> float:
        """How many standard deviations a sighting at this time is away (Mahalanobis)."""
        off, spread = self._off(sighting)
        return math.sqrt(max(0.0, float(off @ np.linalg.solve(spread, off))))

    def after(self, sighting: Sighting) -> "PoseBelief":
        """With a sighting at the time of this belief taken in."""
        off, spread = self._off(sighting)
        gain = np.linalg.solve(spread, self.covariance[POSE]).T
        covariance = self.covariance - gain @ self.covariance[POSE]
        return replace(self, mean=self.mean + gain @ off, covariance=(covariance + covariance.T) / 2)

    def _off(self, sighting: Sighting) -> tuple[FloatArray, FloatArray]:
        """Innovation of a sighting, (3,), and its covariance."""
        seen = sighting.pose
        x_m, y_m, yaw_rad = self.mean[POSE].tolist()
        off = np.array([seen.x_m - x_m, seen.y_m - y_m, wrapped_rad(seen.yaw_rad - yaw_rad)])
        return off, self.covariance[POSE, POSE] + _noise(sighting)


def _noise(sighting: Sighting) -> FloatArray:
    return np.asarray(sighting.covariance + np.diag(LEAST_SIGMA**2))
