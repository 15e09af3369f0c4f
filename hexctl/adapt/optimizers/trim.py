"""Trims: the bias of a gait, learned from its walks, and the search that needs it.

A robot that holds its heading without a position drifts sideways at a repeatable angle. A walk with the trim
t that ends e to the left of its line, s along it, would have ended on the line with

    t' = t - atan2(e, s)

The trim of a gait is the mean of the t' of all its valid walks, which averages out noise.

In open loop a robot curves: the direction of its end is half of its turn. A walk of the duration T with the
turn w wants

    w' = w - 2 atan2(e, s) / T

Each w' has the weight 1 / variance, with a tenth of its correction and `NOISE_RAD` as standard deviations:
large first corrections are a tenth wrong.
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

#: Standard deviation of the direction in which open-loop walks end, and relative error of a correction.
NOISE_RAD = math.radians(0.3)
WRONG = 0.1


def wanted_trim_rad(result: TrialResult) -> float | None:
    """Trim with which a walk would have ended on its line, counter-clockwise.

    Its end is the mean of the last second, to reduce noise. None for an invalid walk, or one without a held
    heading.
    """
    end_m = _end_m(result)
    if result.trim_rad is None or end_m is None:
        return None
    return trimmed_rad(result.trim_rad, distance_m=end_m[0], signed_m=end_m[1])


def wanted_turn_trim_rad_s(result: TrialResult) -> float | None:
    """Turn that would end an open-loop walk on its line, counter-clockwise; None if untrimmed or invalid."""
    end_m = _end_m(result)
    if result.turn_trim_rad_s is None or end_m is None:
        return None
    return result.turn_trim_rad_s - 2 * math.atan2(end_m[1], end_m[0]) / result.duration_s


def _end_m(result: TrialResult) -> tuple[float, float] | None:
    """End of a valid walk, along its line and to its left; None if unknown."""
    end_m = result.path_m[-END_TICKS:]
    end_m = end_m[np.isfinite(end_m).all(axis=-1)]
    if not result.valid or not len(end_m):
        return None
    distance_m, signed_m = end_m.mean(axis=0).tolist()
    # A walk shorter than its soft start may be valid.
    return (distance_m, signed_m) if distance_m > 0 else None


def mean_trim_rad(wanted_rad: Iterable[float]) -> float:
    """Trim of a gait from those of its walks, within the limits of a plan; 0 without any."""
    wanted = list(wanted_rad)
    mean_rad = sum(wanted) / len(wanted) if wanted else 0.0
    return min(max(mean_rad, -MAX_TRIM_RAD), MAX_TRIM_RAD)


def mean_turn_trim_rad_s(walks: Iterable[tuple[float, float, float]]) -> float:
    """Turn trim of a gait of walks (turn, wanted turn, duration), within a plan's limits; 0 without walks."""
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

    Gaits differ in their bias, but a trim corrects all alike: a second walk of the first gait is worth more
    than another gait. The next gait follows an invalid walk, or `WALKS` walks without reaching the target.

    Args:
        seed: not used.
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
