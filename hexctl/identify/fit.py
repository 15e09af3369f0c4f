"""Least squares over replays: parameters at which simulated servos move as measured ones did."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hexctl.identify.servo_parameters import PARAMETERS, ServoValues
from hexctl.types import ArrayFields, FloatArray

#: Error beyond which a sample counts less, so that single wild readings do not decide.
WILD_RAD = np.radians(1.0)

#: Samples of each replay that are compared: enough for the fastest motion.
MOST_SAMPLES = 2000

#: Parts of a single log that are left out in turn for the uncertainty.
PARTS = 8

#: Steps of the search.
MOST_STEPS = 15

#: The search ends where a step gains less than this share, or the error is below what any sensor shows.
ENOUGH_GAIN, SMALL_RAD = 1e-3, np.radians(0.003)


#: Called with the number of a step and the error in rad, a root of the mean robust square.
OnStep = Callable[[int, float], None]


def unreported(_step: int, _error_rad: float) -> None:
    """Nobody follows the search."""


class Replay(Protocol):
    """A measured motion that can be simulated with other servos."""

    @property
    def name(self) -> str:
        """For reports."""

    def errors_rad(self, values: ServoValues) -> FloatArray:
        """Simulated less measured angles, of any shape, the same for all values."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """One identified parameter; the deviation is the standard error of the value, in its unit."""

    value: float
    deviation: float
    unit: str

    @property
    def known(self) -> bool:
        """Whether the motions determine the value: to a third of it, or a dead time to 5 ms."""
        return self.deviation < (0.005 if self.unit == "s" else abs(self.value) / 3)


@dataclass(frozen=True, slots=True, eq=False)
class Fit(ArrayFields):
    """Result of a search.

    Attributes:
        values: the servo found.
        estimates: its searched parameters, by name.
        before_rad: mean absolute error of each replay with the servo at the start, by its name.
        after_rad: the same with the servo found.
    """

    values: ServoValues
    estimates: Mapping[str, Estimate]
    before_rad: Mapping[str, float]
    after_rad: Mapping[str, float]


def mean_errors_rad(replays: Sequence[Replay], values: ServoValues) -> dict[str, float]:
    """Mean absolute error of each replay, by its name."""
    return {one.name: float(np.abs(one.errors_rad(values)).mean()) for one in replays}


def fit_servo(
    replays: Sequence[Replay],
    start: ServoValues,
    names: Sequence[str],
    *,
    on_step: OnStep = unreported,
) -> Fit:
    """Values of the named parameters with the smallest robust squared error over all replays.

    Levenberg-Marquardt with the soft-L1 loss (Triggs et al. 2000, as in `scipy.optimize.least_squares`) over
    the logarithms of positive parameters. The deviations are those of the jackknife over replays, or over
    parts of a single one, linearised at the solution.

    Args:
        names: of `PARAMETERS`; the others keep their values.
        on_step: follows the search.
    """
    search = _Search(replays, start, names)
    at = search.start
    cost, damping = search.cost(at), 1e-2
    for step in range(MOST_STEPS):
        on_step(step, float(np.sqrt(2 * cost / search.samples)))
        errors, slopes = search.linear(at)
        weights = 1 / np.sqrt(1 + (errors / WILD_RAD) ** 2)
        square = slopes.T @ (weights[:, None] * slopes)
        down = slopes.T @ (weights * errors)
        better = None
        while better is None and damping < 1e6:
            try_at = search.inside(
                at - np.linalg.solve(square + damping * np.diag(np.diag(square)) + 1e-12, down)
            )
            new_cost = search.cost(try_at)
            better, damping = (try_at, damping / 5) if new_cost < cost else (None, damping * 5)
        if better is None:
            break
        gain, at, cost = (cost - new_cost) / cost, better, new_cost
        if gain < ENOUGH_GAIN or cost < search.samples * SMALL_RAD**2:
            break
    return search.result(at)


class _Search:
    """The replays as a function of coordinates."""

    def __init__(self, replays: Sequence[Replay], start: ServoValues, names: Sequence[str]) -> None:
        self._replays, self._first = replays, start
        self._free = [PARAMETERS[name] for name in names]
        self.start = self.inside(
            np.array([one.coordinate(getattr(start, one.name)) for one in self._free], dtype=float)
        )
        self._groups: FloatArray = np.zeros(0)
        self.samples = 1

    def inside(self, at: FloatArray) -> FloatArray:
        bounds = [(one.coordinate(one.low), one.coordinate(one.high)) for one in self._free]
        low, high = np.array(bounds).T
        return np.clip(at, low, high)

    def values(self, at: FloatArray) -> ServoValues:
        given = {one.name: one.value(part) for one, part in zip(self._free, at.tolist(), strict=True)}
        return self._first.with_values(given)

    def errors(self, at: FloatArray) -> FloatArray:
        values, parts, groups = self.values(at), [], []
        for index, replay in enumerate(self._replays):
            errors = replay.errors_rad(values)
            flat = errors.reshape(len(errors), -1)
            rows = np.arange(0, len(flat), max(1, len(flat) // MOST_SAMPLES))
            parts.append(flat[rows].ravel())
            part = index if len(self._replays) > 1 else PARTS * rows // len(flat)
            groups.append(np.repeat(np.broadcast_to(part, rows.shape), flat.shape[1]))
        self._groups = np.concatenate(groups)
        found: FloatArray = np.concatenate(parts)
        self.samples = len(found)
        # A servo that flies off is as wrong as half a turn, not as wrong as infinity.
        return np.clip(np.nan_to_num(found, nan=np.pi), -np.pi, np.pi)

    def cost(self, at: FloatArray) -> float:
        share = (self.errors(at) / WILD_RAD) ** 2
        return float(WILD_RAD**2 * (np.sqrt(1 + share) - 1).sum())

    def linear(self, at: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Errors and their slopes, (samples,) and (samples, parameters)."""
        moved = [at]
        for index, one in enumerate(self._free):
            there = at.copy()
            there[index] += one.coordinate_step
            if not np.array_equal(self.inside(there), there):
                there[index] -= 2 * one.coordinate_step
            moved.append(there)
        with ThreadPoolExecutor() as workers:
            errors, *others = workers.map(self.errors, moved)
        slopes = [
            (other - errors) / (there[index] - at[index])
            for index, (other, there) in enumerate(zip(others, moved[1:], strict=True))
        ]
        return errors, np.stack(slopes, axis=-1)

    def result(self, at: FloatArray) -> Fit:
        values, deviations = self.values(at), self._deviations(at)
        estimates = {}
        for one, deviation in zip(self._free, deviations.tolist(), strict=True):
            value = getattr(values, one.name)
            estimates[one.name] = Estimate(
                value, deviation * one.scale if one.linear else deviation * value, one.unit
            )
        return Fit(
            values,
            estimates,
            mean_errors_rad(self._replays, self._first),
            mean_errors_rad(self._replays, values),
        )

    def _deviations(self, at: FloatArray) -> FloatArray:
        """Standard errors of the coordinates: the jackknife over groups, linearised."""
        errors, slopes = self.linear(at)
        weights = 1 / np.sqrt(1 + (errors / WILD_RAD) ** 2)
        groups = np.unique(self._groups)
        moves = []
        for group in groups:
            kept = self._groups != group
            left, weight = slopes[kept], weights[kept]
            square = left.T @ (weight[:, None] * left) + 1e-12 * np.eye(len(at))
            moves.append(np.linalg.lstsq(square, left.T @ (weight * errors[kept]), rcond=None)[0])
        moved = np.array(moves)
        n = len(groups)
        return np.asarray(np.sqrt((n - 1) / n * ((moved - moved.mean(axis=0)) ** 2).sum(axis=0)))
