"""`trim`: search codes and trims together: straighten the gait that promises most, by its paths.

A gait drifts similarly in each walk. A second walk that removes the drift of the first is therefore worth
more than a walk of another gait. A trim changes the turn of a walk and its course:

    h' = h + t - c        w' = w - (t + q (h' - h)) / g

with the course c and the half turn t that `DriftBelief` expects of the last trim (h, w), and its gains g and
q. If the turn is small already it stays, and h' = h - c / (1 + q) brings the end to the line.

A gait promises what is left then: its noise between walks, and the turn that exceeds the limits. A gait that
was not walked promises the noise of a usual one and a share of its unknown drift, over the walks that it
takes to learn its trim. The next walk is of the gait that promises to end nearest to its line.
"""

import math
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from hexctl.adapt.optimizer import Observation, Prediction, TaughtOptimizer, Trim
from hexctl.adapt.prior.acquisition import chance_within
from hexctl.adapt.prior.drift import Drift, drift_of, half_steady_s
from hexctl.adapt.prior.drift_belief import GAIN_SD, LEAST_GAIN, DriftBelief, TrimmedWalk
from hexctl.adapt.prior.samples import DriftSamples
from hexctl.adapt.space import GaitSpace
from hexctl.control.trial_plan import MAX_TRIM_RAD, MAX_TURN_TRIM_RAD_S

#: How much nearer another gait has to end to be worth the walks that teach its trim.
PRICE = 1.5

#: Half turns up to this are not corrected: slip absorbs small trims of the turn, and the course brings the
#: end to the line.
SMALL_TURN_RAD = math.radians(2.5)


class TrimSearch(TaughtOptimizer):
    """Walks the gait that promises most with a trim; `exhausted` when every gait has failed.

    Args:
        codes: of all gaits, the one with the best static margin first; None is ascending order.
        samples: drifts in the worlds of a prior; None without a prior.
        floor_m: minimum distance of a valid walk.
        distance_m: distance of a walk of any gait, without a prior.
        turns: whether walks turn with a trim; False if they hold their heading.
    """

    name = "trim"
    trims = True
    walks_key = "walks"
    belief: ClassVar[type[DriftBelief]] = DriftBelief

    def __init__(
        self,
        space: GaitSpace,
        seed: int,
        *,
        codes: Sequence[int] | None = None,
        samples: DriftSamples | None = None,
        target_m: float = 0.025,
        duration_s: float = 30.0,
        cycle_s: float = 1.0,
        floor_m: float = 0.0,
        distance_m: float = 4.0,
        turns: bool = True,
    ) -> None:
        super().__init__(space, seed)
        self._codes = list(range(1, space.size + 1) if codes is None else codes)
        self._samples, self._target_m, self._turns = samples, target_m, turns
        self._floor_m = floor_m
        self._cycle_s, self._half_s = cycle_s, half_steady_s(duration_s)
        self._distance_m = np.full(space.size, distance_m) if samples is None else samples.distance_m
        self._forget()

    @property
    def exhausted(self) -> bool:
        """True when every gait has failed."""
        return len(self._failed) == self.space.size

    def trim(self, code: int) -> Trim:
        """Trim that the belief expects to straighten the next walk of a gait."""
        return self._straightened(code)[0]

    def predict(self, code: int) -> Prediction:
        """Where the next walk of a gait is expected to end."""
        left_rad, distance_m = self._straightened(code)[1], float(self._distance_m[code - 1])
        sd_m = distance_m * self._belief.forecast(code).sd_rad
        trial_sd_m = math.hypot(sd_m, distance_m * self._belief.noise_rad(code))
        mean_m = distance_m * math.sin(left_rad)
        chance = float(chance_within(np.array(mean_m), np.array(trial_sd_m), self._target_m))
        return Prediction(
            signed_m=mean_m, sd_m=sd_m, trial_sd_m=trial_sd_m, chance=chance, target_m=self._target_m
        )

    def promise_m(self, code: int) -> float:
        """How far off its line a trimmed gait is expected to end."""
        left_rad, noise_rad = self._straightened(code)[1], self._belief.noise_rad(code)
        if code not in self._walked:
            unknown_rad = GAIN_SD * self._belief.forecast(code).sd_rad
            noise_rad = PRICE * math.hypot(noise_rad, unknown_rad)
        return float(self._distance_m[code - 1]) * math.hypot(left_rad, noise_rad)

    def _straightened(self, code: int) -> tuple[Trim, float]:
        """The trim of a gait, and the remaining course error, because trims have limits."""
        expected = self._belief.forecast(code)
        last_rad, last_rad_s = self._walked.get(code, (0.0, 0.0))
        drift = expected.after(last_rad, last_rad_s * self._half_s)
        # A step from the last trim, whose drift is known: the gains that it takes have minima.
        gain, coupled = max(expected.gain, LEAST_GAIN) * self._half_s, max(expected.coupled, 0.0)
        turn_rad_s = last_rad_s
        if self._turns and (code not in self._walked or abs(drift.half_turn_rad) > SMALL_TURN_RAD):
            beside_rad = drift.half_turn_rad - drift.course_rad
            turn_rad_s -= (drift.half_turn_rad + coupled * beside_rad) / gain
        turn_rad_s = _limited(turn_rad_s, MAX_TURN_TRIM_RAD_S)
        turned_rad = drift.course_rad + gain * (turn_rad_s - last_rad_s)
        course_rad = _limited(last_rad - turned_rad / (1 + coupled), MAX_TRIM_RAD)
        left_rad = turned_rad + (1 + coupled) * (course_rad - last_rad)
        return Trim.rounded(math.degrees(course_rad), math.degrees(turn_rad_s)), left_rad

    def _suggest(self, count: int) -> list[int]:
        """One gait for any count: the next trim needs its walk."""
        left = [code for code in self._codes if code not in self._failed] or self._codes
        if not self._promises_m:
            self._promises_m.update((each, self.promise_m(each)) for each in self._codes)
        return [min(left, key=self._promises_m.__getitem__)]

    def _facts(self, score: float, observation: Observation | None) -> list[Any]:
        if observation is None:
            return ["unknown", 0.0, 0.0, None]
        drift = drift_of(observation, self._cycle_s) if observation.finished else None
        numbers = None if drift is None else [drift.course_rad, drift.half_turn_rad, drift.distance_m]
        return [observation.status, observation.trim.course_rad, observation.trim.turn_rad_s, numbers]

    def _observe(
        self,
        code: int,
        status: str,
        course_trim_rad: float,
        turn_trim_rad_s: float,
        numbers: list[float] | None,
    ) -> None:
        drift = None if numbers is None else Drift(**dict(zip(Drift.__slots__, numbers, strict=True)))
        slow = status == "no_progress" and (drift is None or drift.walked_m < self._floor_m)
        if slow or status not in ("ok", "unknown", "no_progress"):
            self._failed.add(code)
        if drift is None:
            return
        self._promises_m.clear()
        self._walked[code] = course_trim_rad, turn_trim_rad_s
        self._belief.observe(TrimmedWalk(code, course_trim_rad, turn_trim_rad_s * self._half_s, drift))

    def _forget(self) -> None:
        super()._forget()
        leg, gaits = self.space.failed_legs[0], self.space.size
        self._belief = self.belief(leg, gaits, self._samples, turns=self._turns)
        self._promises_m: dict[int, float] = {}  # of all codes, until a walk teaches
        self._walked: dict[int, tuple[float, float]] = {}  # the last trim of each code
        self._failed: set[int] = set()


def _limited(angle_rad: float, most_rad: float) -> float:
    return min(max(angle_rad, -most_rad), most_rad)
