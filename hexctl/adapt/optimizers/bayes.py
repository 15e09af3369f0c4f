"""`bayes`: search with a prior of simulated worlds; trials show which of them resemble the robot's."""

from collections.abc import Callable
from typing import Any

import numpy as np

from hexctl.adapt.optimizer import Observation, Prediction, TaughtOptimizer
from hexctl.adapt.prior.acquisition import (
    WORST_M,
    chance_above,
    chance_within,
    expected_gain_m,
    expected_size_m,
    most_promising,
    most_useful,
)
from hexctl.adapt.prior.belief import Belief, Forecast
from hexctl.adapt.prior.samples import N_FEATURES, Samples, chance_of, features_of
from hexctl.adapt.space import GaitSpace
from hexctl.backends.clock import PERIOD_S
from hexctl.control.trial import Enough
from hexctl.types import BoolArray, FloatArray

#: A gait is confirmed when it is within the target with this probability.
SURE = 0.9

#: A walk continues while its chance to end better than the best known, or within the target, is this.
HOPE = 0.01

#: Share of a walk before which it is not stopped early: there the soft start dominates.
EARLIEST = 0.3

#: Number of first trials that are chosen with a horizon of two trials.
LOOKING_AHEAD = 2

#: Standard deviation between trials of one gait before any repeat. Simulated gaits repeat exactly: any small
#: value but 0 will do. The real one is from `ant` in real:0 to real:9, leg 5 locked, 30 s, four repeats with
#: lost commands and noise of 0.5 degrees of yaw, 2 mm, and 0.2 degrees per joint. Over 27 pairs of world and
#: gait it was 1.0 to 10.8 cm, 3.7 at the median and 4.9 RMS. 4 cm lies between both: few worlds dominate the
#: RMS, and repeats correct a value that is too small.
SIMULATED_NOISE_M = 0.001
REAL_NOISE_M = 0.04


class Bayes(TaughtOptimizer):
    """Walks the gait with the maximum expected improvement, given the prior and all trials so far.

    It learns from the course of trials; a score without observations only marks the gait as tried.

    Args:
        noise_m: standard deviation of trials of the same gait, assumed before any repeat.
        uncertainty_m: standard uncertainty that repeats do not reduce, such as the simulation's own. It
            counts only for the confirmation of a gait.
        worth_m: minimum expected gain of all remaining trials to continue; 0 continues always.
        budget: maximum number of trials; with 1 the gain of a single one counts.
        sag_rad: static deflection of the joints in the stance before the first trial, (18,), NaN for an
            unmeasured one; None if unknown.
    """

    name = "bayes"
    judges_target = True

    def __init__(
        self,
        space: GaitSpace,
        seed: int,
        *,
        samples: Samples,
        target_m: float,
        duration_s: float,
        floor_m: float,
        noise_m: float = SIMULATED_NOISE_M,
        uncertainty_m: float = 0.0,
        worth_m: float = 0.0,
        budget: int = 1,
        sag_rad: FloatArray | None = None,
    ) -> None:
        super().__init__(space, seed)
        self._samples, self._target_m, self._uncertainty_m = samples, target_m, uncertainty_m
        self._duration_s, self._noise_m = duration_s, noise_m
        self._floor_m, self._worth_m, self._budget = floor_m, worth_m, budget
        self._sag_rad = sag_rad
        self._known: Forecast | None = None
        self._forget()

    @property
    def finished(self) -> bool:
        """True when a gait is within the target with probability `SURE`, `uncertainty_m` included."""
        code = self.recommended()
        return code is not None and bool(self._chances()[code - 1] >= SURE)

    @property
    def worthwhile(self) -> bool:
        """Whether the trials left are expected to gain `worth_m`, or the best gait needs a repeat.

        Their gain is approximated by the sum of those of as many untried gaits.
        """
        best = self.recommended()
        if best is None or self._worth_m <= 0 or self._worth_repeating(best):
            return True
        forecast, best_m = self.forecast(), min(self._best_m(), WORST_M)
        gain_m = expected_gain_m(forecast.mean_m, forecast.sd_m, best_m) * self._chance_valid()
        left = max(1, self._budget - len(self._trials))
        greatest_m = np.sort(gain_m[~self._tried()])[-left:]
        return min(best_m, float(greatest_m.sum())) >= self._worth_m

    def recommended(self) -> int | None:
        """Walked gait most likely within the target, else with the smallest expected deviation; or None."""
        known, forecast = self._known_good(), self.forecast()
        if not known.any():
            return None
        worth = self._chances()
        if worth[known].max() < HOPE:
            worth = -expected_size_m(forecast.mean_m, forecast.sd_m)
        return int(np.argmax(np.where(known, worth, -np.inf))) + 1

    def predict(self, code: int) -> Prediction:
        """Current prediction for a gait."""
        forecast = self.forecast()
        row = code - 1
        return Prediction(
            signed_m=float(forecast.mean_m[row]),
            sd_m=float(forecast.sd_m[row]),
            trial_sd_m=float(np.hypot(forecast.sd_m[row], forecast.noise_m)),
            chance=float(self._chances()[row]),
            target_m=self._target_m,
        )

    def early_stopping(self, code: int) -> Enough:
        """Predicate that ends a walk of a gait whose path leaves no hope of a good end."""
        bound_m = max(self._target_m, min(self._best_m(), WORST_M))
        # Everything costly happens here, before the walk: the predicate is called between two ticks.
        course = self._belief.course_of(code)

        def should_stop(path_m: FloatArray) -> bool:
            walked_s = len(path_m) * PERIOD_S
            if walked_s < EARLIEST * self._duration_s or not np.isfinite(path_m).all():
                return False
            so_far = Observation(path_m=path_m, duration_s=walked_s, yaw_change_rad=None, status="cut_short")
            mean_m, sd_m = course.end(features_of(so_far, self._duration_s))
            return float(chance_within(np.array(mean_m), np.array(sd_m), bound_m)) < HOPE

        return should_stop

    def _suggest(self, count: int) -> list[int]:
        """One gait for any count: the next choice needs its outcome."""
        return [self._next_code()]

    def _next_code(self) -> int:
        """The best gait again if it may be within the target, else an untried one with the largest gain."""
        tried, best = self._tried(), self.recommended()
        if best is not None and tried.all():
            return best
        if best is not None and self._worth_repeating(best):
            return best
        if tried.all():
            return int(np.argmax(self.forecast().distance_m)) + 1
        choose = most_useful if len(self._trials) < LOOKING_AHEAD else most_promising
        return choose(self.forecast(), self._chance_valid(), tried, self._best_m()) + 1

    def _worth_repeating(self, code: int) -> bool:
        """Whether a walked gait is the best candidate, and its end not known to `uncertainty_m`."""
        chances, forecast = self._chances(), self.forecast()
        if forecast.sd_m[code - 1] < self._uncertainty_m:
            return False
        within = abs(float(forecast.mean_m[code - 1])) <= self._target_m
        return within and bool(chances[code - 1] >= chances[~self._known_good()].max(initial=0.0))

    def _best_m(self) -> float:
        """Smallest expected deviation of a walked gait, infinity before any."""
        known, forecast = self._known_good(), self.forecast()
        sizes_m = expected_size_m(forecast.mean_m, forecast.sd_m)
        return float(sizes_m[known].min(initial=np.inf))

    def _facts(self, score: float, observation: Observation | None) -> list[Any]:
        if observation is None:
            return [score, "unknown", [None] * N_FEATURES]
        features = features_of(observation, self._duration_s).tolist()
        return [score, observation.status, [None if np.isnan(one) else one for one in features]]

    def _observe(self, code: int, score: float, status: str, numbers: list[float | None]) -> None:
        features = np.array([np.nan if number is None else float(number) for number in numbers])
        if features.shape != (N_FEATURES,):
            raise ValueError(f"a trial with {features.size} numbers")
        self._belief.observe(code, features)
        self._known = None

    def _forget(self) -> None:
        super()._forget()
        self._belief = Belief(self._samples, noise_m=self._noise_m, sag_rad=self._sag_rad)
        self._known = None

    def forecast(self) -> Forecast:
        """Current forecast of all gaits."""
        if self._known is None:
            self._known = self._belief.forecast()
        return self._known

    def _chance_valid(self) -> FloatArray:
        """Probability that each gait walks to the end and makes progress, (gaits,)."""
        forecast = self.forecast()
        progress = chance_above(forecast.distance_m, forecast.distance_sd_m, self._floor_m)
        walks = chance_of(self._samples.finished, len(self._samples.features))
        return np.where(self._failed(), 0.0, progress * walks)

    def _chances(self) -> FloatArray:
        """Probability that each gait is within the target and valid, `uncertainty_m` included, (gaits,)."""
        forecast = self.forecast()
        valid = np.where(self._known_good(), 1.0, self._chance_valid())
        sd_m = np.hypot(forecast.sd_m, self._uncertainty_m)
        return chance_within(forecast.mean_m, sd_m, self._target_m) * valid

    def _tried(self) -> BoolArray:
        return self._walked(lambda _: True)

    def _failed(self) -> BoolArray:
        """Gaits that ever fell, made no progress or were cut short; they are not asked for again."""
        return self._walked(lambda status: status not in ("ok", "unknown"))

    def _known_good(self) -> BoolArray:
        return self._walked(lambda status: status == "ok") & ~self._failed()

    def _walked(self, used: Callable[[str], bool]) -> BoolArray:
        rows = np.zeros(self.space.size, dtype=bool)
        rows[[code - 1 for code, _, status, _ in self._trials if used(status)]] = True
        return rows
