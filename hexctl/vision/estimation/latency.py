"""Estimate the latency of a camera from the robot's own motion.

The joints give the motion v(t) of the body on the robot's clock. The tag gives positions y_j at the times a_j
at which pictures arrived. The latency T minimises the squared error of

    y_j = c + k v(a_j - T)

with a shift c and a factor k that accounts for slip. The yaw is a real number. The position is a complex
number, whose k also rotates. Both estimates of T are weighted by their uncertainties.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hexctl.errors import InputError
from hexctl.types import FloatArray, check_finite

#: Range of the search. Pictures can seem to arrive early, because clocks differ.
LEAST_S, MOST_S, STEP_S = -0.1, 0.6, 0.005

#: A latency with a larger standard deviation is rejected.
MOST_SIGMA_S = 0.01

#: Bounds on the factor k, and the minimum share of explained variance.
LEAST_FACTOR, MOST_FACTOR = 0.4, 1.6
LEAST_EXPLAINED = 0.5

#: Sightings farther off than this many typical deviations do not count.
MOST_OFF = 4.0

#: Minimum number of sightings for an estimate.
LEAST_SIGHTINGS = 20

_Values = FloatArray | NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class Latency:
    """A measured latency.

    Attributes:
        latency_s: from the picture to its arrival, on the robot's clock less that of the arrivals.
        sigma_s: one standard deviation.
        factor: motion in the pictures as a share of the motion of the joints.
        explained: share of the motion in the pictures that the joints explain.
    """

    latency_s: float
    sigma_s: float
    factor: float
    explained: float

    @property
    def holds(self) -> bool:
        """Whether it is known well, and possible."""
        return (
            self.sigma_s <= MOST_SIGMA_S
            and self.explained >= LEAST_EXPLAINED
            and LEAST_FACTOR <= self.factor <= MOST_FACTOR
            and LEAST_S + STEP_S < self.latency_s < MOST_S - STEP_S
        )


def measure_latency(
    times_s: FloatArray, moved: FloatArray, arrivals_s: FloatArray, seen: FloatArray
) -> Latency:
    """Latency of a camera that sees a body move.

    Args:
        times_s: of the body's own motion, ascending, (T,).
        moved: the body's poses by its joints, such as sums of `leg_motions`: x, y in m and unwrapped yaw in
            rad in any frame, (T, 3).
        arrivals_s: when pictures came, ascending, (N,).
        seen: poses seen in them in the floor's frame, (N, 3); yaws may be wrapped.

    Raises InputError for too little motion, for a tag that does not follow the joints, and for arrays that do
    not fit.
    """
    check_finite(moved, (len(times_s), 3), "motion")
    check_finite(seen, (len(arrivals_s), 3), "sightings")
    usable = (arrivals_s - MOST_S >= times_s[0]) & (arrivals_s - LEAST_S <= times_s[-1])
    if usable.sum() < LEAST_SIGHTINGS:
        raise InputError(
            f"latency: got {usable.sum()} sightings while the joints were known; "
            f"allowed: {LEAST_SIGHTINGS} or more"
        )
    arrivals_s, seen = arrivals_s[usable], seen[usable]
    if not (np.diff(times_s) > 0).all():
        raise InputError("latency: got times of the joints that do not ascend; allowed: ascending ones")
    channels = [
        (moved[:, 2], np.unwrap(seen[:, 2])),
        (moved[:, :2] @ np.array([1, 1j]), seen[:, :2] @ np.array([1, 1j])),
    ]
    found = [_delay(times_s, own, arrivals_s, picture) for own, picture in channels]
    good = [one for one in found if one.holds]
    if not good:
        raise InputError(_refusal(found))
    weights = np.array([one.sigma_s for one in good]) ** -2.0
    latency_s = float(np.average([one.latency_s for one in good], weights=weights))
    return replace(good[0], latency_s=latency_s, sigma_s=float(weights.sum() ** -0.5))


def _refusal(found: list[Latency]) -> str:
    best = min(found, key=lambda fit: fit.sigma_s)
    if best.sigma_s > MOST_SIGMA_S or best.explained < LEAST_EXPLAINED:
        return (
            f"latency: got too little motion (known within {1000 * min(best.sigma_s, 9.999):.0f} ms); "
            f"allowed: motion that gives it within {1000 * MOST_SIGMA_S:g} ms, such as a twist to and fro"
        )
    return (
        f"latency: got a tag that moves {best.factor:.2f} times as far as the joints, "
        f"{1000 * best.latency_s:.0f} ms later; allowed: {LEAST_FACTOR:g} to {MOST_FACTOR:g} times, "
        f"{1000 * LEAST_S:g} to {1000 * MOST_S:g} ms"
    )


def _delay(times_s: FloatArray, own: _Values, arrivals_s: FloatArray, seen: _Values) -> Latency:
    """Delay of what was seen against the body's own motion, both real or both complex."""
    delays_s = np.arange(LEAST_S, MOST_S + STEP_S / 2, STEP_S)
    kept = np.ones(len(seen), dtype=bool)
    for _ in range(3):
        left = np.array(
            [_fitted(times_s, own, arrivals_s[kept] - delay_s, seen[kept])[1] for delay_s in delays_s]
        )
        delay_s = _lowest(delays_s, left)
        factor, _, shift = _fitted(times_s, own, arrivals_s[kept] - delay_s, seen[kept])
        off = np.abs(seen - factor * _at(times_s, own, arrivals_s - delay_s) - shift)
        kept = off <= MOST_OFF * max(float(np.median(off)) * 1.5, 1e-12)
    return _judged(times_s, own, arrivals_s[kept], seen[kept], delay_s)


def _judged(
    times_s: FloatArray, own: _Values, arrivals_s: FloatArray, seen: _Values, delay_s: float
) -> Latency:
    """A delay with its uncertainty: that of the least squares, linearised in delay, factor and shift."""
    at_s = arrivals_s - delay_s
    factor, left, _ = _fitted(times_s, own, at_s, seen)
    value = _at(times_s, own, at_s)
    rate = factor * (_at(times_s, own, at_s + STEP_S) - _at(times_s, own, at_s - STEP_S)) / (2 * STEP_S)
    # What a change of the delay does that no factor and no shift can do as well.
    others = np.column_stack([value, np.ones_like(value)])
    alone = rate - others @ np.linalg.lstsq(others, rate, rcond=None)[0]
    told = float(np.square(np.abs(alone)).sum())
    numbers = 2 if np.iscomplexobj(seen) else 1
    variance = left / max(1, numbers * (len(seen) - 2) - 1)
    spread = float(np.square(np.abs(seen - seen.mean())).sum())
    sigma_s = math.sqrt(variance / told) if told > 0 else math.inf
    return Latency(delay_s, sigma_s, abs(factor), 1 - left / spread if spread > 0 else 0.0)


def _fitted(
    times_s: FloatArray, own: _Values, at_s: FloatArray, seen: _Values
) -> tuple[complex, float, complex]:
    """Factor, residual sum of squares and shift of the least-squares fit."""
    value = _at(times_s, own, at_s)
    off, picture = value - value.mean(), seen - seen.mean()
    square = float(np.square(np.abs(off)).sum())
    factor = complex(np.vdot(off, picture)) / square if square > 0 else 0j
    left = float(np.square(np.abs(picture - factor * off)).sum())
    return factor, left, complex(seen.mean() - factor * value.mean())


def _at(times_s: FloatArray, own: _Values, at_s: FloatArray) -> _Values:
    return np.interp(at_s, times_s, own)


def _lowest(delays_s: FloatArray, left: FloatArray) -> float:
    """Minimum of a curve, from a parabola through its lowest point and the neighbours."""
    index = int(left.argmin())
    if not 0 < index < len(left) - 1:
        return float(delays_s[index])
    before, here, after = left[index - 1 : index + 2].tolist()
    bend = before - 2 * here + after
    return float(delays_s[index] + (STEP_S * (before - after) / (2 * bend) if bend > 0 else 0.0))
