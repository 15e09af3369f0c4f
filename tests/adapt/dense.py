"""The belief's joint normal as one big matrix, written out from the docstrings: an independent oracle."""

import math
from dataclasses import dataclass, field

import numpy as np

from hexctl.adapt.prior.belief import (
    ALIKE_CYCLES,
    ALIKE_SHARE,
    BLUR,
    COMMON_SHARE,
    NEGLIGIBLE,
    NOISE,
    RESOLUTION_RAD,
    UNEXPLAINED,
)
from hexctl.adapt.prior.samples import FINAL, N_FEATURES, Samples
from hexctl.adapt.space import GaitSpace
from hexctl.types import FloatArray
from tests.adapt.priors import GAITS

Trial = tuple[int, FloatArray]


@dataclass
class Dense:
    """The joint normal of all gaits times features, as one big matrix, gait by gait."""

    samples: Samples
    noise_m: float
    widened: float = 1.0
    seen: list[Trial] = field(default_factory=list)

    def __post_init__(self) -> None:
        x = self.samples.features
        worlds = len(x)
        self.mean = x.mean(axis=0).ravel()
        apart = x - x.mean(axis=0)
        flat = apart.reshape(worlds, -1)
        pooled = apart.reshape(-1, N_FEATURES)
        self.shape = UNEXPLAINED * pooled.T @ pooled / len(pooled)
        distance = GaitSpace((self.samples.leg,)).phase_distance
        alike = COMMON_SHARE + ALIKE_SHARE * np.exp(-distance / ALIKE_CYCLES)
        alike[np.diag_indices(GAITS)] = 1.0
        spread = apart[..., FINAL].std(axis=0)
        spread = np.maximum(spread, max(np.median(spread) / 2, 1e-3))
        spread /= math.sqrt((spread**2).mean())
        alike *= np.outer(spread, spread)
        self.prior = flat.T @ flat / (worlds - 1) + np.kron(alike, self.shape)

    def stand(self, sag_rad: FloatArray) -> None:
        """Condition the worlds' part on a sag, (18,): joints by their spread, along what worlds share."""
        assert self.samples.sag_rad is not None
        failed = slice(3 * (self.samples.leg - 1), 3 * self.samples.leg)
        sags, sag_rad = (np.delete(array, failed, axis=-1) for array in (self.samples.sag_rad, sag_rad))
        spread = np.sqrt(sags.var(axis=0) + RESOLUTION_RAD**2)
        apart = (sags - sags.mean(axis=0)) / spread
        flat = (self.samples.features - self.samples.features.mean(axis=0)).reshape(len(sags), -1)
        variances, directions = np.linalg.eigh(apart.T @ apart / (len(sags) - 1))
        told = directions[:, variances > NEGLIGIBLE]
        across = flat.T @ apart @ told / (len(sags) - 1)
        among = told.T @ apart.T @ apart @ told / (len(sags) - 1) + NOISE * np.eye(told.shape[1])
        seen = told.T @ ((sag_rad - sags.mean(axis=0)) / spread)
        self.mean = self.mean + across @ np.linalg.solve(among, seen)
        self.prior = self.prior - across @ np.linalg.solve(among, across.T)

    def numbers(self) -> tuple[list[int], list[int], list[float]]:
        """Place, trial and value of every number seen."""
        places, trials, values = [], [], []
        for index, (code, features) in enumerate(self.seen):
            for feature in range(N_FEATURES):
                if not math.isnan(features[feature]):
                    places.append((code - 1) * N_FEATURES + feature)
                    trials.append(index)
                    values.append(float(features[feature]))
        return places, trials, values

    def posterior(self, feature: int) -> tuple[FloatArray, FloatArray]:
        """Mean and covariance of one feature of all gaits."""
        wanted = np.arange(GAITS) * N_FEATURES + feature
        prior = self.widened * self.prior
        places, trials, values = self.numbers()
        if not places:
            return self.mean[wanted], prior[np.ix_(wanted, wanted)]
        noisy = self._covariance(places, trials)
        across = prior[np.ix_(wanted, np.array(places))]
        mean = self.mean[wanted] + across @ np.linalg.solve(noisy, np.array(values) - self.mean[places])
        return mean, prior[np.ix_(wanted, wanted)] - across @ np.linalg.solve(noisy, across.T)

    def surprise(self) -> list[float]:
        """Error of each end in standard deviations, given all trials before it."""
        everything, found = self.seen, []
        for index, (code, features) in enumerate(everything):
            if math.isnan(features[FINAL]):
                continue
            end = np.full(N_FEATURES, np.nan)
            end[FINAL] = features[FINAL]
            self.seen = [*everything[:index], (code, end)]
            places, trials, values = self.numbers()
            covariance = self._covariance(places, trials)
            off = np.array(values) - self.mean[places]
            before, last = covariance[:-1, :-1], covariance[-1, :-1]
            mean = last @ np.linalg.solve(before, off[:-1]) if index else 0.0
            variance = covariance[-1, -1] - (last @ np.linalg.solve(before, last) if index else 0.0)
            found.append((off[-1] - mean) / math.sqrt(variance))
        self.seen = everything
        return [float(one) for one in found]

    def end_of_trial(self, code: int, features: FloatArray) -> tuple[float, float]:
        """Mean and standard deviation of the end of one walk that has shown some features so far."""
        everything = self.seen
        self.seen = [*everything, (code, features)]
        places, trials, values = self.numbers()
        self.seen = everything
        covariance = self._covariance([*places, (code - 1) * N_FEATURES + FINAL], [*trials, len(everything)])
        before, last = covariance[:-1, :-1], covariance[-1, :-1]
        weights = np.linalg.solve(before, last) if places else np.zeros(0)
        mean = self.mean[(code - 1) * N_FEATURES + FINAL] + weights @ (
            np.array(values) - self.mean[np.array(places, dtype=int)]
        )
        return float(mean), math.sqrt(covariance[-1, -1] - weights @ last)

    def _covariance(self, places: list[int], trials: list[int]) -> FloatArray:
        at = np.array(places, dtype=int)
        covariance: FloatArray = self.widened * self.prior[np.ix_(at, at)]
        features = at % N_FEATURES
        together = np.equal.outer(trials, trials)
        noise = self.shape[np.ix_(features, features)] * self.noise_m**2 / self.shape[FINAL, FINAL]
        covariance += np.where(together, noise, 0.0)
        blur = np.where(features == FINAL, 0.0, BLUR * np.diagonal(self.shape)[features])
        return np.asarray(covariance + np.diag(blur + 1e-9 * np.diagonal(covariance) + 1e-12))
