"""Trims: what a session learns of the bias of a gait, and the search that needs it.

A robot that holds its heading and does not know its position drifts aside at an angle that the next walk of
the same gait repeats. A walk with the trim t that ends e to the left of its line, s along it, would have
ended on the line with

    t' = t - atan2(e, s)

The trim of a gait is the mean of the t' of all its valid walks, so that noise of where a walk ends averages
out.

A robot that knows nothing walks in open loop, and there it curves: its end lies off the line by half of what
it has turned. A turn that goes with the walk takes that out. A walk of the duration T with the turn w wants

    w' = w - 2 atan2(e, s) / T

Here the first ends are far off, where a correction is a tenth wrong; so each w' counts by 1 / variance, with
a tenth of its own correction as one part of the standard deviation and `NOISE_RAD` of where walks end as the
other.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.optimizer import Optimizer
from hexctl.adapt.space import GaitSpace
from hexctl.control.assessment.score import END_TICKS
from hexctl.control.trial_plan import MAX_TRIM_RAD, MAX_TURN_TRIM_RAD_S
from hexctl.control.trial_result import TrialResult
from hexctl.control.walks.steering import trimmed_rad
from hexctl.errors import InputError

#: Walks of a gait after which a trim that has not brought it within the target is taken not to converge.
WALKS = 4

#: Standard deviation of the direction in which walks in open loop end, and the share by which a correction of
#: the turn is wrong.
NOISE_RAD = math.radians(0.3)
WRONG = 0.1


def wanted_trim_rad(result: TrialResult) -> float | None:
    """Trim with which a walk would have ended on its line, counter-clockwise.

    Its end is the mean of the last second, which a position with noise knows better than its last tick. None
    for a walk that did not hold its heading, or is not valid.
    """
    end_m = _end_m(result)
    if result.trim_rad is None or end_m is None:
        return None
    return trimmed_rad(result.trim_rad, distance_m=end_m[0], signed_m=end_m[1])


def wanted_turn_trim_rad_s(result: TrialResult) -> float | None:
    """Turn with which a walk in open loop would have ended on its line, counter-clockwise.

    None for a walk without such a trim, or one that is not valid.
    """
    end_m = _end_m(result)
    if result.turn_trim_rad_s is None or end_m is None:
        return None
    return result.turn_trim_rad_s - 2 * math.atan2(end_m[1], end_m[0]) / result.duration_s


def _end_m(result: TrialResult) -> tuple[float, float] | None:
    """Where a valid walk ended, along its line and to its left; None where that is not known."""
    end_m = result.path_m[-END_TICKS:]
    end_m = end_m[np.isfinite(end_m).all(axis=-1)]
    if not result.valid or not len(end_m):
        return None
    distance_m, signed_m = end_m.mean(axis=0).tolist()
    # A walk shorter than its soft start may be valid.
    return (distance_m, signed_m) if distance_m > 0 else None


def mean_trim_rad(wanted_rad: Iterable[float]) -> float:
    """Trim of a gait from what each of its walks wants, within what a plan takes; 0 without any."""
    wanted = list(wanted_rad)
    mean_rad = sum(wanted) / len(wanted) if wanted else 0.0
    return min(max(mean_rad, -MAX_TRIM_RAD), MAX_TRIM_RAD)


def mean_turn_trim_rad_s(walks: Iterable[tuple[float, float, float]]) -> float:
    """Turn trim of a gait, within what a plan takes; 0 without walks.

    Args:
        walks: the turn with which each walked, the turn that it wants, and its duration.
    """
    rates, weights = [], []
    for walked_rad_s, wanted_rad_s, duration_s in walks:
        noise_rad_s = 2 * NOISE_RAD / duration_s
        rates.append(wanted_rad_s)
        weights.append(1 / (noise_rad_s**2 + (WRONG * (wanted_rad_s - walked_rad_s)) ** 2))
    if not rates:
        return 0.0
    mean_rad_s = sum(weight * rate for weight, rate in zip(weights, rates, strict=True)) / sum(weights)
    return min(max(mean_rad_s, -MAX_TURN_TRIM_RAD_S), MAX_TURN_TRIM_RAD_S)


class TrimSearch(Optimizer):
    """Walks one gait until its trim has converged; the next gait only if that fails.

    Gaits differ in their bias and hardly in how well a trim takes it out, so that a second walk of the first
    gait is worth more than the first walk of any other one. The next gait comes after an invalid walk, or
    after `WALKS` walks of a gait: the session ends at its target before that where the trim converges.

    Args:
        space: of the gaits.
        seed: not used; the order decides.
        codes: of the gaits, the most promising one first; None is from 1 on.
    """

    name = "trim"

    def __init__(self, space: GaitSpace, seed: int, *, codes: Sequence[int] | None = None) -> None:
        super().__init__(space, seed)
        self._codes = list(range(1, space.size + 1) if codes is None else codes)
        if sorted(self._codes) != list(range(1, space.size + 1)):
            raise InputError(f"trim: got {len(self._codes)} codes; allowed: each of 1..{space.size} once")
        self._index, self._walks = 0, 0

    @property
    def exhausted(self) -> bool:
        """True when the trim of every gait has failed."""
        return self._index == len(self._codes)

    def _suggest(self, count: int) -> list[int]:
        return [self._codes[self._index]]

    def _learn(self, codes: list[int], scores: list[float]) -> None:
        self._walks += 1
        if scores[0] >= INVALID_SCORE or self._walks == WALKS:
            self._index, self._walks = self._index + 1, 0

    def _search_state(self) -> dict[str, Any]:
        return {"codes": list(self._codes), "place": self._index, "walks": self._walks}

    def _restore_search(self, state: dict[str, Any]) -> None:
        self._codes = [int(code) for code in state["codes"]]
        self._index, self._walks = int(state["place"]), int(state["walks"])
