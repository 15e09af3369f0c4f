"""How a walk drifts off its line: the course to its end, and how far it has turned.

The path is cut into cycles of the gait, the soft start left out. The mean position of a cycle has neither
the sway of the body nor most of the sensor's noise; chords between such means give the direction of travel,
and a straight line fitted to it over time the turn rate. A path of a few points (a tape) has chords between
its points. If only the end is known, the walk counts as an arc that begins along the line.
"""

import math
from dataclasses import dataclass

import numpy as np

from hexctl.adapt.optimizer import Observation
from hexctl.gait.foot_trajectory import RAMP_DURATION_S
from hexctl.types import FloatArray

#: Duration over which the end of a walk is averaged.
END_S = 1.0


def half_steady_s(duration_s: float) -> float:
    """Half of the duration that the same distance takes without a soft start."""
    return max(duration_s - RAMP_DURATION_S / 2, RAMP_DURATION_S / 2) / 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Drift:
    """Drift of one walk.

    Attributes:
        course_rad: direction from the start to the end of the walk, from the line, counter-clockwise.
        half_turn_rad: half of the angle by which the direction of travel turned, counter-clockwise: an arc
            that begins along the line has it as its course.
        distance_m: distance from the start to the end.
    """

    course_rad: float
    half_turn_rad: float
    distance_m: float

    @property
    def walked_m(self) -> float:
        """Length of the arc, which a trim would make the distance."""
        return self.distance_m / max(float(np.sinc(self.half_turn_rad / math.pi)), 0.2)


def drift_of(walk: Observation, cycle_s: float) -> Drift | None:
    """Drift of a walk with gait cycles of a duration; None without a known end."""
    period_s = walk.duration_s / max(1, len(walk.path_m))
    times_s = period_s * np.arange(1.0, len(walk.path_m) + 1)
    known = np.isfinite(walk.path_m).all(axis=-1)
    late = known & (times_s > walk.duration_s - END_S)
    if not late.any():
        return None
    end_m = walk.path_m[late].mean(axis=0)
    course_rad = math.atan2(end_m[1], end_m[0])
    half_turn_rad = course_rad
    points_m = np.asarray(walk.path_m[known], dtype=float)
    at_s, points_m = _means(times_s[known], points_m, walk.duration_s, cycle_s)
    if len(points_m) > 2:
        half_turn_rad = _turn_rad_s(at_s, points_m) * half_steady_s(walk.duration_s)
    return Drift(course_rad=course_rad, half_turn_rad=half_turn_rad, distance_m=float(np.hypot(*end_m)))


def _means(
    times_s: FloatArray, points_m: FloatArray, duration_s: float, cycle_s: float
) -> tuple[FloatArray, FloatArray]:
    """Mean time, (n,), and position, (n, 2), of each full cycle before the end; of few points, these."""
    cycle = np.floor((duration_s - times_s) / cycle_s + 1e-9)
    inside = cycle < math.floor((duration_s - RAMP_DURATION_S) / cycle_s)
    members = np.unique(cycle[inside], return_inverse=True)[1]
    counts = np.bincount(members)
    if counts.size and counts.max() > 1:
        columns = (times_s[inside], *points_m[inside].T)
        means = np.stack([np.bincount(members, column) / counts for column in columns], axis=-1)[::-1]
        return means[:, 0], means[:, 1:]
    return np.append(RAMP_DURATION_S / 2, times_s), np.vstack([np.zeros(2), points_m])


def _turn_rad_s(times_s: FloatArray, points_m: FloatArray) -> float:
    """Slope of the direction of travel over time, by least squares."""
    steps_m = np.diff(points_m, axis=0)
    direction_rad = np.unwrap(np.arctan2(steps_m[:, 1], steps_m[:, 0]))
    apart_s = (times_s[1:] + times_s[:-1]) / 2
    apart_s = apart_s - apart_s.mean()
    return float(apart_s @ direction_rad / (apart_s @ apart_s))
