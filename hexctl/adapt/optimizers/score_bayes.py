"""`bayes` for steered walks: searches speed, cost, tilt or steadiness with a prior of simulated worlds."""

from typing import Any

import numpy as np

from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.optimizer import Observation, TaughtOptimizer
from hexctl.adapt.prior.acquisition import expected_excess
from hexctl.adapt.prior.belief import TRUST_TRIALS, likeness
from hexctl.adapt.prior.samples import ScoreSamples, chance_of
from hexctl.adapt.space import GaitSpace
from hexctl.types import BoolArray, FloatArray

#: Standard deviation between trials of one gait, in the logarithm of the score: of 1 cm sensor noise over
#: 3 m in simulation; assumed on a real robot.
SIMULATED_NOISE, REAL_NOISE = 0.005, 0.03

#: Expected gain of the trials that are left below which the search ends, as a share of the score.
WORTH = 0.01

#: Scores below this, which no walk has, are taken as this.
LEAST_SCORE = 1e-9

#: The numbers s, c and a of `ScoreBelief`; the length is `ALIKE_CYCLES`, in mean phase difference.
#: Chosen by leaving each of three worlds a leg out of the prior of `ant`: speed after 3 trials is then 0.7 %
#: from the best, 1.5 % with the whole covariance of the worlds and 30 % of the other part added to it.
SHRUNK, COMMON, ALIKE = 0.5, 0.2, 0.4

#: Least standard deviation between worlds, in the logarithm.
LEAST_SD = 0.01


class ScoreBelief:
    """Belief over the scores of the 120 gaits of a failed leg: jointly normal in the logarithm.

    Scores of gaits differ by factors, and a world changes all of them together. With f the log scores of the
    120 gaits, W worlds of the prior and their rows y_w,

        f ~ N(m, S),    m = mean of y_w
        S = (1 - s) sum (y_w - m)(y_w - m)^T / (W - 1) + s v (c 1 1^T + a K + (1 - c - a) I)

    The covariance of few worlds has low rank and is shrunk (Ledoit & Wolf 2004) toward the mean variance v of
    a gait: a share common to all gaits, one that is alike for gaits in similar phases, K = exp(-distance /
    length), and each gait's own. Trials are conditioned on (Rasmussen & Williams 2006, eq. 2.23 and 2.24).

    `noise` is the standard deviation of trials of the same gait, in the logarithm.
    """

    def __init__(self, samples: ScoreSamples, *, noise: float) -> None:
        self._mean = samples.log_scores.mean(axis=0)
        apart = samples.log_scores - self._mean
        shown = apart.T @ apart / max(len(apart) - 1, 1)
        variance = max(float(np.diagonal(shown).mean()), LEAST_SD**2)
        rest = likeness(samples.leg, COMMON, ALIKE)
        self._covariance = (1 - SHRUNK) * shown + SHRUNK * variance * rest
        self._noise = noise
        self._rows: list[int] = []
        self._seen: list[float] = []

    def observe(self, code: int, log_score: float) -> None:
        """Add the log score of a valid trial of a gait."""
        self._rows.append(code - 1)
        self._seen.append(log_score)

    def forecast(self) -> tuple[FloatArray, FloatArray]:
        """Means (gaits,) and covariance (gaits, gaits) of all current log scores.

        If trials surprise more than expected the prior is widened: no world is explained away.
        """
        if not self._rows:
            return self._mean.copy(), self._covariance.copy()
        rows, surprise = np.array(self._rows), np.array(self._seen) - self._mean[self._rows]
        among, noise = self._covariance[np.ix_(rows, rows)], self._noise**2 * np.eye(rows.size)
        squares = float(surprise @ np.linalg.solve(among + noise, surprise))
        widened = max(1.0, (TRUST_TRIALS + squares) / (TRUST_TRIALS + rows.size))
        across = widened * self._covariance[rows]  # (trials, gaits)
        weights = np.linalg.solve(widened * among + noise, across)
        return self._mean + weights.T @ surprise, widened * self._covariance - across.T @ weights


class ScoreBayes(TaughtOptimizer):
    """Walks the gait with the maximum expected improvement of the log score, given the prior and all trials.

    It uses no random numbers, and shares the name `bayes` with the search for straight walks.

    Args:
        noise: standard deviation of trials of the same gait, in the logarithm.
        worth: minimum expected gain of all remaining trials, as a share of the best score; 0 continues
            always.
        budget: maximum number of trials; with 1 the gain of a single one counts.
    """

    name = "bayes"

    def __init__(
        self,
        space: GaitSpace,
        seed: int,
        *,
        samples: ScoreSamples,
        noise: float = SIMULATED_NOISE,
        worth: float = 0.0,
        budget: int = 1,
    ) -> None:
        super().__init__(space, seed)
        self._samples, self._noise, self._worth, self._budget = samples, noise, worth, budget
        self._forget()

    @property
    def worthwhile(self) -> bool:
        """Whether the trials left are expected to gain `worth`: the sum over as many untried gaits."""
        if self._worth <= 0 or self.recommended() is None:
            return True
        left = max(1, self._budget - len(self._trials))
        gains = np.sort(self._gains()[~self._tried])[-left:]
        return float(gains.sum()) >= self._worth

    def recommended(self) -> int | None:
        """Walked gait with the best expected score that was always valid; None before any."""
        if not self._good.any():
            return None
        return int(np.argmin(np.where(self._good, self._forecast[0], np.inf))) + 1

    def _suggest(self, count: int) -> list[int]:
        """One gait for any count: the next choice needs its outcome."""
        best = self.recommended()
        if self._tried.all():
            return [best if best is not None else int(np.argmin(self._forecast[0])) + 1]
        return [int(np.argmax(np.where(self._tried, -np.inf, self._gains()))) + 1]

    def _gains(self) -> FloatArray:
        """Expected improvement of each gait on the best walked one, before any on the median, (gaits,)."""
        mean, covariance = self._forecast
        best = float(mean[self._good].min()) if self._good.any() else float(np.median(mean))
        sd = np.sqrt(np.maximum(np.diagonal(covariance), 1e-12))
        chance = chance_of(self._samples.valid, len(self._samples.log_scores))
        return expected_excess(best - mean, sd) * np.where(self._tried & ~self._good, 0.0, chance)

    @property
    def _tried(self) -> BoolArray:
        return self._rows([code for code, _ in self._trials])

    @property
    def _good(self) -> BoolArray:
        return self._tried & ~self._rows([code for code, score in self._trials if score >= INVALID_SCORE])

    def _rows(self, codes: list[int]) -> BoolArray:
        rows = np.zeros(self.space.size, dtype=bool)
        rows[[code - 1 for code in codes]] = True
        return rows

    def _facts(self, score: float, observation: Observation | None) -> list[Any]:
        return [score]

    def _observe(self, code: int, score: float) -> None:
        if score < INVALID_SCORE:
            self._belief.observe(code, float(np.log(max(score, LEAST_SCORE))))
            self._forecast = self._belief.forecast()

    def _forget(self) -> None:
        super()._forget()
        self._belief = ScoreBelief(self._samples, noise=self._noise)
        self._forecast = self._belief.forecast()
