"""Belief over the scores of all gaits of steered walks: jointly normal in the logarithm.

Scores of gaits differ by factors, and a world changes all of them together. With f the log scores of the 120
gaits, W worlds of the prior and their rows y_w,

    f ~ N(m, S),    m = mean of y_w
    S = (1 - s) sum (y_w - m)(y_w - m)^T / (W - 1) + s v (c 1 1^T + a K + (1 - c - a) I)

The covariance of few worlds has low rank and is shrunk (Ledoit & Wolf 2004) toward the mean variance v of a
gait: a share common to all gaits, one that is alike for gaits in similar phases, K = exp(-distance / length),
and each gait's own. Trials are conditioned on (Rasmussen & Williams 2006, eq. 2.23 and 2.24).
"""

import numpy as np

from hexctl.adapt.prior.belief import TRUST_TRIALS, likeness
from hexctl.adapt.prior.samples import ScoreSamples
from hexctl.types import FloatArray

#: The numbers s, c and a of the equation above; the length is `ALIKE_CYCLES`, in mean phase difference.
#: Chosen by leaving each of three worlds a leg out of the prior of `ant`: speed after 3 trials is then 0.7 %
#: from the best, 1.5 % with the whole covariance of the worlds and 30 % of the other part added to it.
SHRUNK, COMMON, ALIKE = 0.5, 0.2, 0.4

#: Least standard deviation between worlds, in the logarithm.
LEAST_SD = 0.01


class ScoreBelief:
    """Belief about the log scores of the 120 gaits of a failed leg, after any number of trials.

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
