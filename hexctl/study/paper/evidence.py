"""Evidence for a claim: numbers of several worlds, tolerances, intervals over worlds, and verdicts."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexctl.types import FloatArray

#: The paper's deviations: about 10 cm after 20 evaluations, about 2.5 cm after 60.
EARLY, EARLY_M = 20, 0.10
LATE, LATE_M = 60, 0.025

#: Relative deviation that "about" allows from a number of the paper.
ABOUT = 0.5

#: Confidence of the intervals over worlds.
CONFIDENCE = 0.95

#: Shorter walks are not judged: deviations grow with time, and claims and bars are for this duration.
JUDGED_FROM_S = 30.0

#: Results of `judge`.
WITHIN, BELOW, ABOVE, ACROSS, UNKNOWN = "within", "below", "above", "across", "unknown"


@dataclass(frozen=True)
class Tolerance:
    """Range of values that agree with a claim, both ends included; in the unit of the number."""

    low: float = -np.inf
    high: float = np.inf

    @classmethod
    def about(cls, low: float, high: float | None = None) -> "Tolerance":
        """Return the tolerance of "about `low`", or of "about `low` to `high`"."""
        return cls(low * (1 - ABOUT), (low if high is None else high) * (1 + ABOUT))


@dataclass(frozen=True)
class Measure:
    """One number of a claim, measured in each world.

    Attributes:
        name: what was measured, such as `leg 2` or `pso`.
        values: one for each world; NaN if it cannot be judged.
        note: counts behind it, or why it is not judged.
        most: largest possible value, such as 1 for a share.
    """

    name: str
    values: tuple[float, ...]
    note: str = ""
    most: float = np.inf
    least: float = 0.0

    @cached_property
    def known(self) -> FloatArray:
        """Values of the worlds in which it can be judged."""
        values = np.array(self.values, dtype=float)
        return np.asarray(values[np.isfinite(values)])

    @property
    def mean(self) -> float:
        """Mean over the worlds; NaN without any."""
        return mean(self.known)

    @cached_property
    def interval(self) -> tuple[float, float]:
        """Confidence interval of the mean over worlds (Student's t), within the possible values.

        For one world it is the mean itself.
        """
        if self.known.size < 2:
            return self.mean, self.mean
        from scipy.special import stdtrit

        error = self.known.std(ddof=1) / np.sqrt(self.known.size)
        half = float(stdtrit(self.known.size - 1, 0.5 + CONFIDENCE / 2) * error)
        return max(self.least, self.mean - half), min(self.most, self.mean + half)


def mean(values: FloatArray) -> float:
    """Mean of values; NaN without any."""
    return float(values.mean()) if values.size else float("nan")


def clustered_error(values: FloatArray, groups: NDArray[Any]) -> FloatArray:
    """Standard error of the mean of values, (n, ...), if groups, (n,), such as worlds, are independent.

    The cluster-robust error for N values in W groups: sqrt(W / (W - 1) * sum of squares of the groups'
    residual sums) / N. NaN for fewer than two groups.
    """
    numbers = np.unique(groups)
    if len(numbers) < 2:
        return np.full(values.shape[1:], np.nan)
    residuals = (values - values.mean(axis=0)) / len(values)
    sums = np.array([residuals[groups == number].sum(axis=0) for number in numbers])
    return np.asarray(np.sqrt(len(numbers) / (len(numbers) - 1) * (sums**2).sum(axis=0)))


def judge(measure: Measure, tolerance: Tolerance) -> str:
    """Return the position of an interval: within a tolerance, below, above, across its limit, or unknown.

    Across is no evidence: such worlds differ by more than their distance from the limit.
    """
    if not measure.known.size:
        return UNKNOWN
    low, high = measure.interval
    if tolerance.low <= low and high <= tolerance.high:
        return WITHIN
    if high < tolerance.low:
        return BELOW
    return ABOVE if low > tolerance.high else ACROSS


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """A verdict, or the reason why there is none.

    Attributes:
        holds: None without a verdict.
        not_judged: why the numbers cannot be judged; empty if they can.
        no_evidence: why the numbers decide nothing; empty if they do.
    """

    holds: bool | None = None
    not_judged: str = ""
    no_evidence: str = ""

    @property
    def verdict(self) -> str:
        """Verdict in words."""
        if self.not_judged:
            return f"not judged: {self.not_judged}"
        if self.no_evidence:
            return f"no evidence: {self.no_evidence}"
        return {True: "holds", False: "does not hold", None: "not measured"}[self.holds]


def judge_all(measures: Sequence[Measure], tolerance: Tolerance) -> Verdict:
    """Return the verdict on all numbers of a claim: each has to be within its tolerance."""
    sides = [judge(measure, tolerance) for measure in measures]
    if BELOW in sides or ABOVE in sides:
        return Verdict(holds=False)
    if UNKNOWN in sides:
        unknown = [one for one, side in zip(measures, sides, strict=True) if side == UNKNOWN]
        return Verdict(not_judged="; ".join(f"{one.name}: {one.note}" for one in unknown))
    if ACROSS in sides:
        return Verdict(no_evidence="the interval over worlds reaches across the limit")
    return Verdict(holds=True if measures else None)


@dataclass(frozen=True, kw_only=True)
class Claim(Verdict):
    """A claim of the paper and the numbers of this study.

    Attributes:
        rule: condition under which it holds here.
        measured: the numbers, with intervals if there are several worlds.
        beside: comparison, such as the result of the random baseline.
        symmetric: which symmetry implies the claim; empty without one.
        null: result on random numbers; empty without a comparison.
    """

    claim: str
    rule: str
    measured: str
    beside: str = ""
    symmetric: str = ""
    null: str = ""


def too_short(duration_s: float) -> str:
    """Reason why walks of a duration are not judged, empty if they are long enough."""
    if duration_s >= JUDGED_FROM_S:
        return ""
    return f"walks of {duration_s:g} s, needs at least {JUDGED_FROM_S:g} s"


def cm(value_m: float) -> str:
    """Length in m as text in cm."""
    if not np.isfinite(value_m):
        return "none"
    return f"{100 * value_m:.1f} cm" if abs(value_m) >= 0.01 else f"{100 * value_m:.2f} cm"


def with_error(value: float, error: float, text: Callable[[float], str] = "{:.2f}".format) -> str:
    """Text of a value, with its standard error if known."""
    return text(value) + (f" ± {text(error)}" if np.isfinite(error) else "")


def cm_with_error(value_m: float, error_m: float) -> str:
    """Text of a length in m with its standard error, in cm."""
    return with_error(value_m, error_m, cm)


def share_with_error(value: float, error: float) -> str:
    """Text of a share with its standard error; a dash if it is unknown."""
    return with_error(value, error) if np.isfinite(value) else "-"


def limit_text(value_m: float) -> str:
    """Limit in m as text in cm, with all its digits."""
    return f"{100 * value_m:g} cm"


def share_text(share: float) -> str:
    """Share as text in percent."""
    return f"{share:.0%}"


def measures_text(measures: Sequence[Measure], text: Callable[[float], str], tolerance: Tolerance) -> str:
    """Numbers on one line: mean, interval over worlds, on which side it misses the tolerance, and counts."""
    return "; ".join(_measure_text(measure, text, tolerance) for measure in measures) or "not measured"


def _measure_text(measure: Measure, text: Callable[[float], str], tolerance: Tolerance) -> str:
    note = f" ({measure.note})" if measure.note else ""
    if not measure.known.size:
        return f"{measure.name}: no number{note}"
    worlds = measure.known.size
    interval = " [{} to {}, {} worlds]".format(*map(text, measure.interval), worlds) if worlds > 1 else ""
    side = judge(measure, tolerance)
    limit = {BELOW: tolerance.low, ABOVE: tolerance.high}.get(side)
    missed = f", {side} {limit_text(limit) if text is cm else text(limit)}" if limit is not None else ""
    return f"{measure.name} {text(measure.mean)}{interval}{missed}{note}"
