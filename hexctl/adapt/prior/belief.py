"""Gaussian process over all gaits, with mean and covariance from simulated worlds.

Prior: the 120 gaits times N_FEATURES numbers are jointly normal, with mean and covariance of the simulated
worlds, plus an unexplained part. It has the usual shape over a walk (deviation grows with time, late
deviations correlate with early ones), and is more alike for gaits with similar phases. Trials are conditioned
on as usual (Rasmussen & Williams 2006, eq. 2.23 and 2.24), all numbers of a walk together. If ends of walks
surprise more than expected, the complete prior is widened: no world is explained away.

Stance: the static deflection of the joints depends on servo stiffness and load, and so shows which worlds the
robot resembles. Deflections are jointly normal with the landscapes over the worlds of a prior; landscapes are
conditioned on them in the coordinates of the worlds.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hexctl.adapt.prior.samples import DISTANCE, FINAL, N_FEATURES, Samples
from hexctl.adapt.space import GaitSpace
from hexctl.types import BoolArray, FloatArray, leg_slice

#: Variance of an observation's noise, relative to that between the worlds along each principal direction.
NOISE = 0.1

#: Assumed resolution of measured angles (Dynamixel AX-12A: 0.29 degrees); without it, joints with small
#: differences between worlds would count as exact.
RESOLUTION_RAD = math.radians(0.3)

#: Directions in which the worlds differ by less than this share of a joint's variance are ignored.
NEGLIGIBLE = 0.02

#: Maximum doublings of the noise; an observation that needs more would have no effect.
DOUBLINGS = 60


def narrowed(sags_rad: FloatArray, seen_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Condition the coordinates of the worlds, standard normal before, on an observed deflection.

    A landscape is mean + root.T @ x, with a row of the root for each world. If no world explains the sag, its
    noise is raised: a robot with play in its joints resembles no simulated one.

    Args:
        sags_rad: of the worlds, NaN if the robot fell, (worlds, joints).
        seen_rad: of this robot, NaN for unmeasured joints, (joints,).

    Returns:
        Mean of x, (worlds,), and the factor of its root, (worlds, worlds).
    """
    worlds, stood = len(sags_rad), np.isfinite(sags_rad).all(axis=1)
    if stood.sum() < 2:
        return np.zeros(worlds), np.eye(worlds)
    known = np.isfinite(seen_rad)
    spread = np.hypot(sags_rad[stood].std(axis=0), RESOLUTION_RAD)
    mean = sags_rad[stood][:, known].mean(axis=0)
    apart = np.zeros((worlds, int(known.sum())))  # zero for worlds in which the robot fell
    apart[stood] = (sags_rad[stood][:, known] - mean) / spread[known] / np.sqrt(stood.sum() - 1)
    left, sizes, right = np.linalg.svd(apart, full_matrices=False)
    told = sizes**2 > NEGLIGIBLE
    if not told.any():
        return np.zeros(worlds), np.eye(worlds)
    left, sizes = left[:, told], sizes[told]
    surprise = right[told] @ ((seen_rad[known] - mean) / spread[known])
    noise = _noise(sizes**2, surprise)
    weights = sizes / (sizes**2 + noise)
    shrunk = 1 - np.sqrt(noise / (sizes**2 + noise))
    return left @ (weights * surprise), np.eye(worlds) - (left * shrunk) @ left.T


def _noise(variances: FloatArray, surprise: FloatArray) -> float:
    """Minimum noise, at least NOISE, for which a surprise is within its expectation."""
    noise = NOISE
    for _ in range(DOUBLINGS):
        if float((surprise**2 / (variances + noise)).mean()) <= 1:
            break
        noise *= 2
    return noise


#: Unexplained variance as a share of that between the worlds. This and the numbers below were chosen by
#: leaving worlds out of the prior of `ant`, and on worlds of `transfer` outside its benchmark.
UNEXPLAINED = 0.2

#: Unexplained shares: common to all gaits (a slope, a bent leg, pull to one side), and common to similar
#: gaits, with the length scale (mean phase difference between legs, in cycles).
COMMON_SHARE = 0.25
ALIKE_SHARE = 0.4
ALIKE_CYCLES = 0.15

#: Noise of the features before the end, as a share of the unexplained: bumps and sway.
BLUR = 0.5

#: Weight, in trials, of the assumed spread against that of the trials.
TRUST_TRIALS = 4.0

#: Weight, in repeats, of the assumed noise.
NOISE_WEIGHT = 2.0


@dataclass(frozen=True, eq=False)
class Forecast:
    """Belief about the final deviation and the distance of every gait.

    Attributes:
        mean_m: signed final deviation, (gaits,).
        covariance_m2: of the signed final deviations, without the noise of a trial, (gaits, gaits).
        distance_m: progress at the end, (gaits,).
        distance_sd_m: its standard deviation, (gaits,).
        noise_m: standard deviation of one trial around the mean of its gait.
        widened: factor of the prior's width after surprises, 1 or more.
    """

    mean_m: FloatArray
    covariance_m2: FloatArray
    distance_m: FloatArray
    distance_sd_m: FloatArray
    noise_m: float
    widened: float

    @property
    def sd_m(self) -> FloatArray:
        """Standard deviations of the signed final deviations, (gaits,)."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance_m2), 1e-10))


_END_FIRST = np.array([FINAL, *(feature for feature in range(N_FEATURES) if feature != FINAL)])


class _Seen(NamedTuple):
    """Observed numbers of trials, one entry each: N_FEATURES times the row of a gait, plus the feature."""

    trial: NDArray[np.int64] = np.zeros(0, dtype=np.int64)
    number: NDArray[np.int64] = np.zeros(0, dtype=np.int64)
    value: FloatArray = np.zeros(0)

    @property
    def ends(self) -> BoolArray:
        """Entries that are ends of walks."""
        return np.asarray(self.number % N_FEATURES == FINAL)


@dataclass(frozen=True, eq=False)
class Course:
    """Belief about one walk: mean and covariance of its N_FEATURES features.

    `blur` is the variance of features on the way around what the end predicts, (N_FEATURES,).
    """

    mean: FloatArray
    covariance: FloatArray
    blur: FloatArray

    def end(self, features: FloatArray) -> tuple[float, float]:
        """Mean and standard deviation of the end in m, given the features so far, NaN for unknown ones."""
        known = np.flatnonzero(np.isfinite(features))
        if not known.size:
            return float(self.mean[FINAL]), float(np.sqrt(self.covariance[FINAL, FINAL]))
        among = self.covariance[np.ix_(known, known)] + np.diag(self.blur[known])
        weights = np.linalg.solve(among, self.covariance[known, FINAL])
        mean_m = self.mean[FINAL] + weights @ (features[known] - self.mean[known])
        variance = self.covariance[FINAL, FINAL] - weights @ self.covariance[known, FINAL]
        return float(mean_m), float(np.sqrt(max(variance, 1e-10)))


@dataclass(frozen=True, eq=False)
class _Evidence:
    """Root of the observations' covariance, whitened surprise, and factor of the prior's variance."""

    root: FloatArray
    surprise: FloatArray
    widened: float


class Belief:
    """Belief about the 120 gaits of a failed leg, after any number of trials.

    Args:
        samples: the prior's worlds.
        noise_m: standard deviation of trials of the same gait, known in advance.
        sag_rad: static deflection of each joint in the stance, NaN if not measured, (18,). The failed leg's
            is ignored unless it shows what broke: a locked one may be locked at any angle.
    """

    def __init__(self, samples: Samples, *, noise_m: float, sag_rad: FloatArray | None = None) -> None:
        worlds = len(samples.features)
        self._mean = samples.features.mean(axis=0)  # (gaits, N_FEATURES)
        apart = samples.features - self._mean
        # Square root of the worlds' covariance: columns are gait-major, as all flat arrays here.
        self._root = apart.reshape(worlds, -1) / np.sqrt(max(worlds - 1, 1))
        self._shape = UNEXPLAINED * np.einsum("mgi,mgj->ij", apart, apart) / (worlds * len(self._mean))
        spread = spread_of(apart[..., FINAL])
        self._alike = likeness(samples.leg, COMMON_SHARE, ALIKE_SHARE) * np.outer(spread, spread)
        self._noise_m = noise_m
        self._seen = _Seen()
        if sag_rad is not None and samples.sag_rad is not None:
            told_rad = np.array(sag_rad, dtype=float)
            if not samples.failed_leg_tells:
                told_rad[leg_slice(samples.leg)] = np.nan
            shift, shrink = narrowed(samples.sag_rad, told_rad)
            self._mean = self._mean + (shift @ self._root).reshape(self._mean.shape)
            self._root = shrink @ self._root

    def observe(self, code: int, features: FloatArray) -> None:
        """Add a trial of a gait by its features, (N_FEATURES,), NaN for unknown ones."""
        # The end first: its surprise is then separate from that of the course.
        known = _END_FIRST[np.isfinite(features[_END_FIRST])]
        trial, numbers = np.full(known.size, len(self._seen.trial)), N_FEATURES * (code - 1) + known
        self._seen = _Seen(*map(np.append, self._seen, (trial, numbers, features[known])))

    def forecast(self) -> Forecast:
        """Current forecast of all gaits."""
        noise_m = self._noise_now_m()
        evidence = self._weighed(noise_m)
        mean_m, covariance = self._of_all_gaits(evidence, FINAL)
        distance_m, distance_covariance = self._of_all_gaits(evidence, DISTANCE)
        return Forecast(
            mean_m=mean_m,
            covariance_m2=covariance,
            distance_m=distance_m,
            distance_sd_m=np.sqrt(np.maximum(np.diagonal(distance_covariance), 1e-10)),
            noise_m=noise_m,
            widened=evidence.widened,
        )

    def course_of(self, code: int) -> Course:
        """Belief about one walk of a gait, its own noise included."""
        noise_m = self._noise_now_m()
        numbers = N_FEATURES * (code - 1) + np.arange(N_FEATURES)
        mean, covariance = self._conditioned(self._weighed(noise_m), numbers)
        noise = self._noise(noise_m, numbers)
        return Course(mean=mean, covariance=covariance + noise, blur=BLUR * np.diagonal(self._shape))

    def _of_all_gaits(self, evidence: _Evidence, feature: int) -> tuple[FloatArray, FloatArray]:
        """Mean (gaits,) and covariance (gaits, gaits) of one feature of all gaits."""
        return self._conditioned(evidence, N_FEATURES * np.arange(len(self._mean)) + feature)

    def _conditioned(self, evidence: _Evidence, numbers: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
        """Mean (n,) and covariance (n, n) of n numbers."""
        from scipy.linalg import solve_triangular

        seen, widened = self._seen, evidence.widened
        mean = self._mean.ravel()[numbers]
        covariance = widened * self._covariance(numbers, numbers)
        if not seen.value.size:
            return mean, covariance
        across = widened * self._covariance(seen.number, numbers)
        explained = solve_triangular(evidence.root, across, lower=True)
        return mean + explained.T @ evidence.surprise, covariance - explained.T @ explained

    def _covariance(self, numbers: NDArray[np.int64], others: NDArray[np.int64]) -> FloatArray:
        """Prior covariance of n numbers with m others, (n, m)."""
        shape = self._shape[np.ix_(numbers % N_FEATURES, others % N_FEATURES)]
        alike = self._alike[np.ix_(numbers // N_FEATURES, others // N_FEATURES)]
        return np.asarray(self._root[:, numbers].T @ self._root[:, others] + alike * shape)

    def _noise(self, noise_m: float, numbers: NDArray[np.int64]) -> FloatArray:
        """Covariance of a trial's noise; it has the shape over a walk that all deviations have."""
        features = numbers % N_FEATURES
        shape = self._shape[np.ix_(features, features)]
        return np.asarray(shape * (noise_m**2 / self._shape[FINAL, FINAL]))

    def _weighed(self, noise_m: float) -> _Evidence:
        """Evidence, with the prior as wide as the ends of the walks require, 1 at least."""
        evidence, ends = self._decomposed(noise_m, 1.0), self._seen.ends
        # Whitened in the order of the trials: each end against the belief just before it.
        squares = float((evidence.surprise[ends] ** 2).sum())
        widened = (TRUST_TRIALS + squares) / (TRUST_TRIALS + int(ends.sum()))
        return evidence if widened <= 1 else self._decomposed(noise_m, widened)

    def _decomposed(self, noise_m: float, widened: float) -> _Evidence:
        from scipy.linalg import cholesky, solve_triangular

        seen = self._seen
        covariance = widened * self._covariance(seen.number, seen.number)
        together = seen.trial[:, np.newaxis] == seen.trial
        covariance += np.where(together, self._noise(noise_m, seen.number), 0.0)
        blur = np.where(seen.ends, 0.0, BLUR * np.diagonal(self._shape)[seen.number % N_FEATURES])
        covariance[np.diag_indices_from(covariance)] += blur + 1e-9 * np.diagonal(covariance) + 1e-12
        surprise = seen.value - self._mean.ravel()[seen.number]
        if not seen.value.size:
            return _Evidence(covariance, surprise, widened)
        root = cholesky(covariance, lower=True)
        return _Evidence(root, solve_triangular(root, surprise, lower=True), widened)

    def _noise_now_m(self) -> float:
        """Noise of a trial: the assumed one, corrected by the differences between repeats of a gait."""
        numbers, values = self._seen.number[self._seen.ends], self._seen.value[self._seen.ends]
        squares, repeats = NOISE_WEIGHT * self._noise_m**2, NOISE_WEIGHT
        for number in np.unique(numbers):
            again = values[numbers == number]
            squares += float(((again - again.mean()) ** 2).sum())
            repeats += again.size - 1
        return float(np.sqrt(squares / repeats))


def likeness(leg: int, common: float, alike: float) -> FloatArray:
    """Correlation of two gaits beyond what worlds explain, 0..1, (gaits, gaits).

    Args:
        leg: the failed leg.
        common: share that is common to all gaits.
        alike: share that is common to gaits in similar phases; the rest is each gait's own.
    """
    apart_cycles = GaitSpace((leg,)).phase_distance
    near = alike * np.exp(-apart_cycles / ALIKE_CYCLES)
    return np.asarray(common + near + (1 - common - alike) * np.eye(len(apart_cycles)))


def spread_of(apart: FloatArray) -> FloatArray:
    """Spread of each gait over the worlds relative to that of all: sensitive gaits surprise more."""
    spread = apart.std(axis=0)
    # A gait that always fell has no known spread, which is not a spread of zero.
    spread = np.maximum(spread, max(float(np.median(spread)) / 2, 1e-3))
    return np.asarray(spread / np.sqrt((spread**2).mean()))
