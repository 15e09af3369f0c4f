"""Belief about the drift of all gaits, and about what a trim does to it: one joint normal.

A walk i of the gait c, with the trim of its course h and of its turn w (as half a turn, w T / 2), has by
`hexctl.adapt.prior.drift` the course and the half turn

    course_i    = a_c + g w_i + (1 + q) h_i + noise    (a, b) ~ N(mean, covariance of the worlds of a prior)
    half turn_i = b_c + g w_i + q h_i       + noise    g ~ N(GAIN, GAIN_SD^2), q ~ N(COUPLED, COUPLED_SD^2)

A robot that is to walk a little to its side also turns to that side, by q. Worlds of a prior explain how
gaits drift together; the rest is alike for gaits in similar phases, as in `hexctl.adapt.prior.belief`. All
walks are conditioned on (Rasmussen & Williams 2006, eq. 2.23 and 2.24). The regression on g and q is the
secant through the walks of a gait, with the usual gains before there are two. A walk counts less by how far
it turned: g is the slope of a curve, which is straight nearby only.

The noise of a gait is estimated from what its walks leave unexplained.
"""

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from hexctl.adapt.prior.belief import ALIKE_SHARE, COMMON_SHARE, UNEXPLAINED, likeness, spread_of
from hexctl.adapt.prior.drift import Drift
from hexctl.adapt.prior.samples import DriftSamples
from hexctl.types import FloatArray

#: Turn of the robot per commanded turn, its standard deviation between worlds, and its minimum: play in the
#: joints absorbs small turns, but not larger ones.
GAIN, GAIN_SD, LEAST_GAIN = 0.75, 0.25, 0.6

#: Half turn per trimmed course, and its standard deviation between worlds.
COUPLED, COUPLED_SD = 1.0, 1.0

#: Error of a walk per half turn that it made.
CURVED = 0.1

#: Standard deviation of the course of walks of one gait before any repeat, and its weight in repeats.
NOISE_RAD = math.radians(0.5)
NOISE_WEIGHT = 1.0

#: Noise of the half turn over that of the course.
TURN_NOISE = 2.0

#: Drift without a prior: standard deviation of the half turn, and of the course less the half turn.
HALF_TURN_SD_RAD, BESIDE_SD_RAD = math.radians(15.0), math.radians(2.0)

#: Passes in which noise and drift are estimated in turn.
PASSES = 4


@dataclass(frozen=True, slots=True)
class TrimmedWalk:
    """A walk of a gait, with the trim of its course and of half its turn."""

    code: int
    course_trim_rad: float
    half_turn_trim_rad: float
    drift: Drift


@dataclass(frozen=True, slots=True, kw_only=True)
class DriftForecast:
    """Expected drift of one gait without a trim, the gains of a trim, and how well its course is known."""

    course_rad: float
    half_turn_rad: float
    gain: float
    coupled: float
    sd_rad: float

    def after(self, course_trim_rad: float, half_turn_trim_rad: float) -> "DriftForecast":
        """The drift with a trim."""
        turned_rad = self.gain * half_turn_trim_rad + self.coupled * course_trim_rad
        return replace(
            self,
            course_rad=self.course_rad + course_trim_rad + turned_rad,
            half_turn_rad=self.half_turn_rad + turned_rad,
        )


class DriftBelief:
    """Belief about the gaits of a failed leg; `samples` None stands for any world.

    `turns` is False for walks that hold their heading, whose course is trimmed without a turn.
    """

    gain_sd: ClassVar[float] = GAIN_SD

    def __init__(self, leg: int, gaits: int, samples: DriftSamples | None, *, turns: bool = True) -> None:
        self._gains = np.array([GAIN, COUPLED if turns else 0.0])
        self._gains_covariance = np.diag([self.gain_sd**2, COUPLED_SD**2 if turns else 0.0])
        alike = likeness(leg, COMMON_SHARE, ALIKE_SHARE)
        if samples is None:
            turn, beside = HALF_TURN_SD_RAD**2, BESIDE_SD_RAD**2
            shape = np.array([[turn + beside, turn], [turn, turn]])
            self._mean, self._covariance = np.zeros(2 * gaits), np.kron(alike, shape)
        else:
            mean = samples.drifts_rad.mean(axis=0)
            apart = samples.drifts_rad - mean
            shape = UNEXPLAINED * np.einsum("mgi,mgj->ij", apart, apart) / apart[..., 0].size
            spread = spread_of(apart[..., 0])
            alike = alike * np.outer(spread, spread)
            flat = apart.reshape(len(apart), -1)
            self._mean = mean.ravel()
            self._covariance = flat.T @ flat / max(len(flat) - 1, 1) + np.kron(alike, shape)
        self._walks: list[TrimmedWalk] = []
        self._noise_rad: dict[int, float] = {}
        self._weights = np.zeros(0)

    def observe(self, walk: TrimmedWalk) -> None:
        """Add a walk."""
        self._walks.append(walk)
        self._condition()

    def noise_rad(self, code: int) -> float:
        """Standard deviation of the course between walks of a gait; of an unwalked one, the usual noise."""
        if code in self._noise_rad:
            return self._noise_rad[code]
        return math.exp(float(np.mean(np.log([NOISE_RAD, *self._noise_rad.values()]))))

    def forecast(self, code: int) -> DriftForecast:
        """Expected drift of a gait, and the standard deviation of its course after the trim."""
        rows = np.array([2 * code - 2, 2 * code - 1])
        mean = np.append(self._mean[rows], self._gains)
        covariance = np.zeros((4, 4))
        covariance[:2, :2] = self._covariance[np.ix_(rows, rows)]
        covariance[2:, 2:] = self._gains_covariance
        if self._walks:
            seen, trims = self._seen()
            across = np.vstack([self._covariance[np.ix_(seen, rows)].T, self._gains_covariance @ trims.T])
            mean = mean + across @ self._weights
            covariance = covariance - across @ self._inverse @ across.T
        by = np.array([1.0, 0.0, -mean[1] / max(float(mean[2]), LEAST_GAIN), 0.0])
        return DriftForecast(
            course_rad=float(mean[0]),
            half_turn_rad=float(mean[1]),
            gain=float(mean[2]),
            coupled=float(mean[3]),
            sd_rad=math.sqrt(max(float(by @ covariance @ by), 1e-12)),
        )

    def _seen(self) -> tuple[NDArray[np.int64], FloatArray]:
        """Rows of course and half turn of each walk in the covariance, (2 n,), and its trims, (2 n, 2)."""
        rows = np.array([[2 * walk.code - 2, 2 * walk.code - 1] for walk in self._walks]).ravel()
        trims = [(walk.half_turn_trim_rad, walk.course_trim_rad) for walk in self._walks]
        return rows, np.repeat(trims, 2, axis=0)

    def _condition(self) -> None:
        rows, trims = self._seen()
        drifts = [
            (one.drift.course_rad - one.course_trim_rad, one.drift.half_turn_rad) for one in self._walks
        ]
        surprise = np.array(drifts).ravel() - self._mean[rows] - trims @ self._gains
        prior = self._covariance[np.ix_(rows, rows)] + trims @ self._gains_covariance @ trims.T
        codes = np.array([walk.code for walk in self._walks])
        curved = CURVED * np.array([walk.drift.half_turn_rad for walk in self._walks])
        self._noise_rad = dict.fromkeys(codes.tolist(), NOISE_RAD)
        for _ in range(PASSES):
            noise = np.array([self._noise_rad[code] for code in codes.tolist()])
            variance = np.stack([noise**2 + curved**2, (TURN_NOISE * noise) ** 2 + curved**2], axis=-1)
            self._inverse = np.linalg.inv(prior + np.diag(variance.ravel()))
            self._weights = self._inverse @ surprise
            # What is left of the course, as of walks that went straight, and their degrees of freedom.
            left = (variance.ravel() * self._weights)[::2] ** 2 * noise**2 / variance[:, 0]
            free = variance[:, 0] * np.diagonal(self._inverse)[::2]
            for code in self._noise_rad:
                own = codes == code
                squares = NOISE_WEIGHT * NOISE_RAD**2 + float(left[own].sum())
                self._noise_rad[code] = math.sqrt(squares / (NOISE_WEIGHT + float(free[own].sum())))
