"""Least squares over replays: parameters at which simulated joints move as measured ones did."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from hexctl.identify.parameters import PARAMETERS, SCALE, Estimate, ServoValues
from hexctl.threads import simulation_threads
from hexctl.types import N_JOINTS, ArrayFields, BoolArray, FloatArray

ValuesT = TypeVar("ValuesT", bound=ServoValues)
ReplayedT = TypeVar("ReplayedT", bound=ServoValues, contravariant=True)

#: Error beyond which a sample counts less, so that single wild readings do not decide.
WILD_RAD = np.radians(1.0)

#: Number of compared samples of each replay: enough for the fastest motion.
MOST_SAMPLES = 2000

#: Number of parts of a log, or of logs, omitted in turn for the uncertainty.
PARTS = 8

#: Share of the value at the start below which the step of a slope does not shrink with the value.
LEAST_SHARE = 0.1

#: Steps of the search.
MOST_STEPS = 40

#: Levenberg-Marquardt damping at first, and after a step that gained nothing, as shares of the diagonal.
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-4, 1e3

#: The search ends where a step gains less than this share, or the error is below what any sensor shows.
ENOUGH_GAIN, ROUGH_GAIN, NEAR_GAIN, SMALL_RAD = 1e-3, 5e-2, 2e-2, np.radians(0.003)

#: Called with the number of a step and the error in rad, a root of the mean robust square.
OnStep = Callable[[int, float], None]

#: The same, with the stage of a search first: errors of different stages are of different logs.
OnStage = Callable[[str, int, float], None]


class Replay(Protocol[ReplayedT]):
    """A measured motion that can be simulated with other values."""

    @property
    def name(self) -> str:
        """For reports."""

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters on which the motion depends."""

    @property
    def units(self) -> int:
        """Number of equal blocks of columns of the errors, such as legs, whose true values may differ."""

    def errors_rad(self, values: ReplayedT) -> FloatArray:
        """Simulated less measured angles, of any shape, the same for all values."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit(ArrayFields, Generic[ValuesT]):
    """Result of a search.

    Attributes:
        values: what was found.
        estimates: the searched parameters, by name.
        before_rad: mean absolute error of each replay with the values of the start, by its name.
        after_rad: the same with the values found.
    """

    values: ValuesT
    estimates: Mapping[str, Estimate]
    before_rad: Mapping[str, float]
    after_rad: Mapping[str, float]


def mean_errors_rad(replays: Sequence[Replay[ValuesT]], values: ValuesT) -> dict[str, float]:
    """Mean absolute error of each replay, by its name."""
    return {one.name: float(np.abs(one.errors_rad(values)).mean()) for one in replays}


def fit_values(
    replays: Sequence[Replay[ValuesT]],
    start: ValuesT,
    names: Sequence[str],
    *,
    enough_gain: float = ENOUGH_GAIN,
    on_step: OnStep = lambda _step, _error_rad: None,
) -> Fit[ValuesT]:
    """Values of the named parameters with the smallest robust squared error over all replays.

    Levenberg-Marquardt with the soft-L1 loss (Triggs et al. 2000, as in `scipy.optimize.least_squares`).
    Torques and masses are searched as multiples of the stiffness. The deviations are those of the jackknife
    over replays or over their parts, linearised at the solution.

    Args:
        names: of `PARAMETERS`; the others keep their values.
        enough_gain: share of the cost; a step that gains less is the last.
        on_step: follows the search.
    """
    search = _Search(replays, start, names)
    at = search.errors_at(search.start)
    damping = FIRST_DAMPING
    for step in range(MOST_STEPS):
        on_step(step, at.root_mean_rad)
        slopes = search.slopes(at)
        better, damping = search.step(at, slopes, damping)
        if better is None:
            break
        gain, at = 1 - better.cost / at.cost, better
        if gain < enough_gain or at.root_mean_rad < SMALL_RAD:
            break
    return search.result(at, slopes)


def near_values(
    replays: Sequence[Replay[ValuesT]],
    start: ValuesT,
    names: Sequence[str],
    on_step: OnStep = lambda _step, _error_rad: None,
) -> tuple[float, ValuesT]:
    """Error in rad and values at a place near a minimum, by few replays, for a start far from it.

    Slopes are measured to one side and updated by secants (Broyden 1965) while these help.
    """
    search = _Search(replays, start, names)
    at = search.errors_at(search.start)
    damping, slopes, fresh = FIRST_DAMPING, search.slopes(at, one_sided=True), True
    for step in range(MOST_STEPS):
        on_step(step, at.root_mean_rad)
        if at.root_mean_rad < SMALL_RAD:
            break
        better, damping = search.step(at, slopes, damping, careful=True)
        gain = 0.0 if better is None else 1 - better.cost / at.cost
        if fresh and gain < NEAR_GAIN:
            break
        fresh = gain < ROUGH_GAIN
        if better is not None and not fresh:
            slopes = _secant_slopes(slopes, better.errors - at.errors, better.place - at.place)
        at = better or at
        if fresh:
            damping, slopes = FIRST_DAMPING, search.slopes(at, one_sided=True)
    return at.root_mean_rad, search.values(at.place)


def _secant_slopes(slopes: FloatArray, change: FloatArray, moved: FloatArray) -> FloatArray:
    """The slopes nearest to the last ones that explain how a step changed the errors."""
    scaled = (slopes**2).sum(axis=0) * moved
    return np.asarray(slopes + np.outer(change - slopes @ moved, scaled / (scaled @ moved)))


@dataclass(frozen=True, slots=True, eq=False)
class _Place(ArrayFields):
    """Errors at coordinates of the search, one array for each replay."""

    place: FloatArray
    parts: list[FloatArray]

    @property
    def errors(self) -> FloatArray:
        return np.concatenate(self.parts)

    @property
    def weights(self) -> FloatArray:
        return np.asarray(1 / np.sqrt(1 + (self.errors / WILD_RAD) ** 2))

    @property
    def cost(self) -> float:
        return float(WILD_RAD**2 * (np.sqrt(1 + (self.errors / WILD_RAD) ** 2) - 1).sum())

    @property
    def root_mean_rad(self) -> float:
        return float(np.sqrt(2 * self.cost / len(self.errors)))


class _Search(Generic[ValuesT]):
    """The replays as a function of coordinates.

    They are the values of the parameters, some divided by the stiffness.
    """

    def __init__(self, replays: Sequence[Replay[ValuesT]], start: ValuesT, names: Sequence[str]) -> None:
        self._replays, self._first = replays, start
        self._free = [PARAMETERS[name] for name in names]
        self._scaled = np.array([one.scaled for one in self._free])
        self._scale_at = names.index(SCALE) if SCALE in names else None
        plain = np.array([getattr(start, name) for name in names], dtype=float)
        self.start = self.inside(np.where(self._scaled, plain / getattr(start, SCALE), plain))
        self._relative = np.array([not one.absolute for one in self._free])
        self._least = np.where(self._relative, LEAST_SHARE * np.abs(self.start), 0.0)

    def _anywhere(self, at: FloatArray) -> FloatArray:
        """Values of the parameters, also beyond their bounds."""
        scale = getattr(self._first, SCALE) if self._scale_at is None else at[self._scale_at]
        return np.where(self._scaled, at * scale, at)

    def _plain(self, at: FloatArray) -> FloatArray:
        """Values of the parameters, within their bounds."""
        low, high = np.array([(one.low, one.high) for one in self._free]).T
        return np.clip(self._anywhere(at), low, high)

    def _free_at(self, at: _Place, down: FloatArray) -> BoolArray:
        """Parameters that a step down does not move out of their bounds, at which they are."""
        low, high = np.array([(one.low, one.high) for one in self._free]).T
        plain = self._plain(at.place)
        return np.asarray(np.where(down > 0, plain > low, plain < high))

    def inside(self, at: FloatArray) -> FloatArray:
        """The nearest coordinates within the bounds of the parameters."""
        plain = self._plain(at)
        scale = getattr(self._first, SCALE) if self._scale_at is None else plain[self._scale_at]
        return np.where(self._scaled, plain / scale, plain)

    def errors_at(self, at: FloatArray) -> _Place:
        with simulation_threads() as workers:
            return _Place(at, list(workers.map(lambda replay: self._errors(replay, at), self._replays)))

    def step(
        self, at: _Place, slopes: FloatArray, damping: float, *, careful: bool = False
    ) -> tuple[_Place | None, float]:
        """A better place, or None if there is none, and the next damping."""
        square = slopes.T @ (at.weights[:, None] * slopes)
        down = slopes.T @ (at.weights * at.errors)
        free, better = self._free_at(at, down), None
        while better is None and damping < MOST_DAMPING:
            # A parameter without any effect stays where it is.
            damped, change = square + np.diag(damping * np.diag(square) + 1e-12), np.zeros_like(down)
            change[free] = np.linalg.solve(damped[np.ix_(free, free)], down[free])
            if careful:
                # No value above 0 becomes less than a third or more than three times as large.
                most = np.where(self._relative, np.maximum(np.abs(at.place), self._least), np.inf)
                change = np.clip(change, -2 * most, 2 / 3 * most)
            tried = self.errors_at(self.inside(at.place - change))
            better = tried if tried.cost < at.cost else None
            damping = damping / 30 if better else max(LEAST_DAMPING, damping * 10)
        return better, damping

    def slopes(self, at: _Place, *, one_sided: bool = False) -> FloatArray:
        """Slopes of the errors, (samples, parameters)."""
        seen = [
            (row, column)
            for row, replay in enumerate(self._replays)
            for column, one in enumerate(self._free)
            if one.name in replay.parameters
        ]
        found = [np.zeros((len(errors), len(self._free))) for errors in at.parts]
        with simulation_threads() as workers:
            slopes = workers.map(lambda place: self._slope(at, *place, one_sided=one_sided), seen)
            for (row, column), slope in zip(seen, slopes, strict=True):
                found[row][:, column] = slope
        return np.concatenate(found)

    def _slope(self, at: _Place, row: int, column: int, *, one_sided: bool) -> FloatArray:
        one = self._free[column]
        size = 1.0 if one.absolute else max(abs(at.place[column]), self._least[column])
        step = np.zeros(len(self._free))
        step[column] = one.step * size
        both = at.place + step, at.place - step
        ends = [place for place in both if np.allclose(self.inside(place), place)] or both
        high, low = ends if len(ends) > 1 and not one_sided else (ends[0], at.place)
        errors = [
            at.parts[row] if place is at.place else self._errors(self._replays[row], place)
            for place in (high, low)
        ]
        return np.asarray((errors[0] - errors[1]) / (high - low)[column])

    def values(self, at: FloatArray) -> ValuesT:
        names = [one.name for one in self._free]
        return replace(self._first, **dict(zip(names, self._plain(at).tolist(), strict=True)))

    def _errors(self, replay: Replay[ValuesT], at: FloatArray) -> FloatArray:
        errors = replay.errors_rad(self.values(at))
        found = errors.reshape(len(errors), -1)[_rows(len(errors))].ravel()
        # A servo that flies off is as wrong as half a turn, not as wrong as infinity.
        return np.clip(np.nan_to_num(found, nan=np.pi), -np.pi, np.pi)

    def result(self, at: _Place, slopes: FloatArray) -> Fit[ValuesT]:
        """Result at a place, with the slopes of the last step, which are those here."""
        values, deviations = self.values(at.place), self._deviations(at, slopes)
        estimates = {
            one.name: one.estimate(getattr(values, one.name), deviation)
            for one, deviation in zip(self._free, deviations.tolist(), strict=True)
        }
        return Fit(
            values,
            estimates,
            mean_errors_rad(self._replays, self._first),
            {one.name: float(np.abs(part).mean()) for one, part in zip(self._replays, at.parts, strict=True)},
        )

    def _deviations(self, at: _Place, slopes: FloatArray) -> FloatArray:
        """Standard errors, which bounds do not make smaller: jackknives over groups, linearised."""
        variances = [self._variances(at, slopes, groups) for groups in self._groupings(at)]
        return np.where(slopes.any(axis=0), np.sqrt(np.sum(variances, axis=0)), np.inf)

    def _variances(self, at: _Place, slopes: FloatArray, groups: NDArray[np.int64]) -> FloatArray:
        weights, errors = at.weights, at.errors
        names, moves = np.unique(groups), []
        for group in names:
            kept = groups != group
            left, weight = slopes[kept], weights[kept]
            square = left.T @ (weight[:, None] * left)
            change = np.linalg.lstsq(square, left.T @ (weight * errors[kept]), rcond=None)[0]
            moves.append(self._anywhere(at.place - change))
        moved, n = np.array(moves), len(names)
        return np.asarray((n - 1) / n * ((moved - moved.mean(axis=0)) ** 2).sum(axis=0))

    def _groupings(self, at: _Place) -> list[NDArray[np.int64]]:
        """Group of each error: its replay, or its part of a replay if there are few; and its unit.

        Parts show errors of the model, which no motion shares; units show how far legs differ.
        """
        parts, units = 1 if len(self._replays) >= PARTS else PARTS, self._replays[0].units
        sizes = [len(errors) for errors in at.parts]
        by_part = [row * parts + parts * np.arange(size) // size for row, size in enumerate(sizes)]
        by_unit = [np.arange(size) % N_JOINTS * units // N_JOINTS for size in sizes]
        return [np.concatenate(one) for one in ((by_part, by_unit) if units > 1 else (by_part,))]


def _rows(samples: int) -> slice:
    return slice(None, None, max(1, samples // MOST_SAMPLES))
