"""The optimizer that knows before it tries: it believes a prior, and each trial tells which world this is."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from hexctl.adapt.expectation import Expectation
from hexctl.adapt.optimizer import Optimizer
from hexctl.adapt.prior.belief import Belief, Forecast
from hexctl.adapt.prior.choice import chance_above, chance_within, most_useful
from hexctl.adapt.prior.prior import CHECKPOINTS
from hexctl.adapt.prior.samples import N_FEATURES, Samples, features_of
from hexctl.adapt.shown import Shown
from hexctl.adapt.space import GaitSpace
from hexctl.backends.clock import PERIOD_S
from hexctl.control.trial import Enough
from hexctl.errors import InputError
from hexctl.robot.messages import BoolArray, FloatArray

#: A gait is confirmed when it is within the target with this probability.
SURE = 0.9

#: A walk goes on while the chance that it ends better than what is known, or within the target, is this.
HOPE = 0.01

#: What a trial of one and the same gait differs by, until repeats tell: simulated, and on a real floor.
SIMULATED_NOISE_M = 0.001
REAL_NOISE_M = 0.02


class Bayes(Optimizer):
    """Walks the gait that promises most over this trial and the next, given the prior and all trials so far.

    Learns from what a trial showed; without that (`tell` with scores alone) only that the gait was tried.
    Random numbers play no part in it.

    Args:
        space: the gaits of the failed leg.
        seed: taken for the sake of the interface.
        samples: the prior's worlds for this leg.
        target_m: deviation that is good enough.
        duration_s: how long a trial walks.
        floor_m: distance that a valid trial makes at least.
        noise_m: standard deviation of trials of the same gait, as far as it is known before.
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
    ) -> None:
        super().__init__(space, seed)
        if space.failed_legs != (samples.leg,):
            raise InputError(f"prior: got failed legs {space.failed_legs}; allowed: {(samples.leg,)}")
        self._samples, self._target_m = samples, target_m
        self._duration_s, self._noise_m = duration_s, noise_m
        self._floor_m = floor_m
        self._best_m = np.inf
        self._known: Forecast | None = None
        self._forget()

    @property
    def finished(self) -> bool:
        """Return whether some gait is known to be within the target, surely enough."""
        tried = self._tried()
        return bool(tried.any() and self._chances()[tried].max() >= SURE)

    def expect(self, code: int) -> Expectation:
        """Return what is believed of a gait now."""
        forecast = self.forecast()
        row = code - 1
        return Expectation(
            signed_m=float(forecast.mean_m[row]),
            sd_m=float(forecast.sd_m[row]),
            trial_sd_m=float(np.hypot(forecast.sd_m[row], forecast.noise_m)),
            chance=float(self._chances()[row]),
            target_m=self._target_m,
        )

    def enough(self, code: int) -> Enough:
        """Return what says of a walk of a gait, from its path so far, whether its end is no longer open."""
        bound_m = max(self._target_m, min(self._best_m, 1.0))
        looked_at = 0

        def shown_enough(path_m: FloatArray) -> bool:
            nonlocal looked_at
            if not np.isfinite(path_m).all():
                return False
            features, points = self._partial(path_m)
            # Before a third of the walk it is the soft start that shows.
            if points < CHECKPOINTS // 3 or points == looked_at:
                return False
            looked_at = points
            mean_m, sd_m = self._belief.end_of(code, features)
            return float(chance_within(np.array(mean_m), np.array(sd_m), bound_m)) < HOPE

        return shown_enough

    def _partial(self, path_m: FloatArray) -> tuple[FloatArray, int]:
        """Return what a walk shows so far, one row per tick, and at how many checkpoints."""
        walked_s = len(path_m) * PERIOD_S
        shown = Shown(path_m=path_m, duration_s=walked_s, yaw_change_rad=None, status="cut_short")
        return features_of(shown, self._duration_s), int(walked_s / self._duration_s * CHECKPOINTS + 1e-9)

    def _suggest(self, count: int) -> list[int]:
        """Return one gait, whatever the count: the next choice wants its outcome."""
        tried, failed = self._tried(), self._failed()
        chances = self._chances()
        known = tried & ~failed
        if tried.all() or self._worth_repeating(chances, known):
            pool = known if known.any() else tried
            return [int(np.argmax(np.where(pool, chances, -1.0))) + 1]
        return [most_useful(self.forecast(), self._chance_valid(), tried, self._best_m) + 1]

    def _worth_repeating(self, chances: FloatArray, known: BoolArray) -> bool:
        """Return whether a gait that was tried is the likeliest to be within the target."""
        if not known.any():
            return False
        row = int(np.argmax(np.where(known, chances, -1.0)))
        within = abs(float(self.forecast().mean_m[row])) <= self._target_m
        return within and bool(chances[row] >= chances[~known].max(initial=0.0))

    def _learn(self, codes: list[int], scores: list[float]) -> None:
        self._learn_shown(codes, scores, [None] * len(codes))

    def _learn_shown(self, codes: list[int], scores: list[float], shown: Sequence[Shown | None]) -> None:
        for code, score, one in zip(codes, scores, shown, strict=True):
            nothing = np.full(N_FEATURES, np.nan)
            features = nothing if one is None else features_of(one, self._duration_s)
            status = "unknown" if one is None else one.status
            self._take([code, score, status, [None if np.isnan(x) else float(x) for x in features]])

    def _take(self, trial: list[Any]) -> None:
        """Take in one trial as it stands in the saved state."""
        code, score, status, numbers = int(trial[0]), float(trial[1]), str(trial[2]), trial[3]
        self._trials.append([code, score, status, list(numbers)])
        features = np.array([np.nan if number is None else float(number) for number in numbers])
        if features.shape != (N_FEATURES,):
            raise ValueError(f"a trial with {features.size} numbers")
        self._belief.observe(code, features)
        if status == "ok" and np.isfinite(features[CHECKPOINTS - 1]):
            self._best_m = min(self._best_m, abs(float(features[CHECKPOINTS - 1])))
        self._known = None

    def _forget(self) -> None:
        self._belief = Belief(self._samples, noise_m=self._noise_m)
        self._trials: list[list[Any]] = []
        self._best_m, self._known = np.inf, None

    def forecast(self) -> Forecast:
        """Return what is believed of all gaits now."""
        if self._known is None:
            self._known = self._belief.forecast()
        return self._known

    def _chance_valid(self) -> FloatArray:
        """Return the probability that each gait walks to the end and makes progress, (gaits,)."""
        forecast = self.forecast()
        progress = chance_above(forecast.distance_m, forecast.distance_sd_m, self._floor_m)
        worlds = len(self._samples.features)
        # Rule of succession: never seen to fall is not never.
        walks = (worlds * self._samples.finished + 1) / (worlds + 2)
        return np.where(self._failed(), 0.0, progress * walks)

    def _chances(self) -> FloatArray:
        """Return the probability that each gait is within the target and valid, (gaits,)."""
        forecast = self.forecast()
        valid = np.where(self._succeeded(), 1.0, self._chance_valid())
        return chance_within(forecast.mean_m, forecast.sd_m, self._target_m) * valid

    def _tried(self) -> BoolArray:
        return self._with_status(lambda _: True)

    def _succeeded(self) -> BoolArray:
        return self._with_status(lambda status: status == "ok")

    def _failed(self) -> BoolArray:
        return self._with_status(lambda status: status not in ("ok", "unknown")) & ~self._succeeded()

    def _with_status(self, wanted: Any) -> BoolArray:
        rows = np.zeros(self.space.size, dtype=bool)
        rows[[code - 1 for code, _, status, _ in self._trials if wanted(status)]] = True
        return rows

    def _search_state(self) -> dict[str, Any]:
        return {"trials": [[*trial[:3], list(trial[3])] for trial in self._trials]}

    def _restore_search(self, state: dict[str, Any]) -> None:
        trials = list(state["trials"])
        self._forget()
        for trial in trials:
            self._take(trial)
