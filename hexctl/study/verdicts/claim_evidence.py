"""Evidence for a claim: numbers of several worlds, tolerances, intervals over worlds, and three verdicts."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexctl.study.reports.texts import texts
from hexctl.types import FloatArray

#: After 20 evaluations about 10 cm, after 60 about 2.5 cm, says the paper.
EARLY, EARLY_M = 20, 0.10
LATE, LATE_M = 60, 0.025

#: What "about" means for a number of the paper: up to this share more or less.
ABOUT = 0.5

#: Confidence of the intervals over worlds.
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Tolerance:
    """The values that count as what a claim says, both ends included; in the unit of the number."""

    low: float = -np.inf
    high: float = np.inf

    @classmethod
    def about(cls, low: float, high: float | None = None) -> "Tolerance":
        """Tolerance of "about `low`", or of "about `low` to `high`"."""
        return cls(low * (1 - ABOUT), (low if high is None else high) * (1 + ABOUT))


@dataclass(frozen=True)
class Measure:
    """One number of a claim, measured in each world.

    Attributes:
        name: what it is of, such as `leg 2` or `pso`.
        values: one for each world; NaN where it cannot be judged.
        note: counts behind it, or why it is not judged.
        most: greatest value that is possible, such as 1 for a share.
        least: smallest one; that of a difference is negative.
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
        return float(self.known.mean()) if self.known.size else float("nan")

    @cached_property
    def interval(self) -> tuple[float, float]:
        """Confidence interval of the mean over worlds (Student's t), as far as values are possible.

        For one world it is the mean itself.
        """
        if self.known.size < 2:
            return self.mean, self.mean
        from scipy.special import stdtrit

        error = self.known.std(ddof=1) / np.sqrt(self.known.size)
        half = float(stdtrit(self.known.size - 1, 0.5 + CONFIDENCE / 2) * error)
        return max(self.least, self.mean - half), min(self.most, self.mean + half)


def clustered_error(values: FloatArray, groups: NDArray[Any]) -> FloatArray:
    """Standard error of the mean of values, (n, ...), whose groups, (n,), such as worlds, are independent.

    Of N values in W groups, `W / (W - 1)` times the sum of the squares of the groups' residual sums, its root
    divided by N: the cluster-robust variance of a mean. NaN for fewer than two groups.
    """
    numbers = np.unique(groups)
    if len(numbers) < 2:
        return np.full(values.shape[1:], np.nan)
    residuals = (values - values.mean(axis=0)) / len(values)
    sums = np.array([residuals[groups == number].sum(axis=0) for number in numbers])
    return np.asarray(np.sqrt(len(numbers) / (len(numbers) - 1) * (sums**2).sum(axis=0)))


def wilson_interval(count: int, of: int) -> tuple[float, float]:
    """Wilson's interval of a share, of `CONFIDENCE`; that of none is all there is.

    E. B. Wilson, *Probable inference, the law of succession, and statistical inference*, 1927: the shares p
    with |count / of - p| at most z sqrt(p (1 - p) / of). Cases are taken to be independent.
    """
    if not of:
        return 0.0, 1.0
    z = NormalDist().inv_cdf(0.5 + CONFIDENCE / 2)
    share, more = count / of, z**2 / of
    centre = (share + more / 2) / (1 + more)
    half = math.sqrt(share * (1 - share) * more + more**2 / 4) / (1 + more)
    return max(0.0, centre - half), min(1.0, centre + half)


#: What `judge` answers.
WITHIN, BELOW, ABOVE, ACROSS, UNKNOWN = "within", "below", "above", "across", "unknown"


def judge(measure: Measure, tolerance: Tolerance) -> str:
    """Where the interval of a number lies: within a tolerance, below, above or across its end, or unknown.

    Across is no evidence either way: worlds like these differ by more than they are away from the limit.
    """
    if not measure.known.size:
        return UNKNOWN
    low, high = measure.interval
    if tolerance.low <= low and high <= tolerance.high:
        return WITHIN
    if high < tolerance.low:
        return BELOW
    return ABOVE if low > tolerance.high else ACROSS


@dataclass(frozen=True)
class Judgement:
    """Verdict on several numbers together: all have to be within their tolerance.

    Attributes:
        holds: None where there is no verdict.
        no_evidence: reason why the numbers decide nothing; empty otherwise.
        not_judged: reason why there is no number to judge; empty otherwise.
    """

    holds: bool | None
    no_evidence: str = ""
    not_judged: str = ""


def judge_all(measures: Sequence[Measure], tolerance: Tolerance) -> Judgement:
    """Judgement of all numbers of a claim; without any, the claim was not measured."""
    where = {measure.name: judge(measure, tolerance) for measure in measures}
    if any(side in (BELOW, ABOVE) for side in where.values()):
        return Judgement(False)
    unknown = [measure for measure in measures if where[measure.name] == UNKNOWN]
    if unknown:
        reasons = "; ".join(f"{measure.name}: {measure.note}" for measure in unknown)
        return Judgement(None, not_judged=reasons)
    if any(side == ACROSS for side in where.values()):
        return Judgement(None, no_evidence="the interval over worlds reaches across the limit")
    return Judgement(True if measures else None)


#: A claim that holds in more than this share of the draws of random numbers says nothing when it holds.
NULL_SHARE = 0.05


def null_share(holds: Sequence[bool | None]) -> float:
    """Chance that a claim holds on random numbers, from draws of them: (k + 1) / (n + 1)."""
    return (sum(held is True for held in holds) + 1) / (len(holds) + 1)


#: Shorter walks are not judged: deviations grow with the time walked, and the distances in claims and bars
#: are those of walks of this duration.
JUDGED_FROM_S = 30.0


@dataclass(frozen=True, kw_only=True)
class Claim:
    """A claim of the paper and the numbers of this study.

    Attributes:
        claim: the paper's statement.
        rule: condition under which it counts as held here.
        measured: the numbers, with their intervals over worlds where there are several.
        beside: result of the random baseline, or another fact to compare with.
        holds: None where this study did not measure it, cannot judge it, or has no evidence.
        not_judged: why the numbers cannot be judged; empty where they can.
        no_evidence: why the numbers decide nothing; empty where they do.
        symmetric: which symmetry implies the claim, or another one of the claims; empty where none does.
        null: what random numbers would give; empty for a claim that is not compared with any.
    """

    claim: str
    rule: str
    measured: str
    beside: str
    holds: bool | None
    not_judged: str = ""
    no_evidence: str = ""
    symmetric: str = ""
    null: str = ""

    @property
    def verdict(self) -> str:
        """Verdict in words."""
        return verdict_of(self.holds, self.not_judged, self.no_evidence)


def verdict_of(holds: bool | None, not_judged: str = "", no_evidence: str = "") -> str:
    """Verdict in words; the texts are the reasons why there is none."""
    if not_judged:
        return f"not judged: {not_judged}"
    if no_evidence:
        return f"no evidence: {no_evidence}"
    return {True: "holds", False: "does not hold", None: "not measured"}[holds]


def too_short(duration_s: float) -> str:
    """Reason why walks of a duration are not judged, empty for those that are long enough."""
    if duration_s >= JUDGED_FROM_S:
        return ""
    return f"walks of {duration_s:g} s, needs at least {JUDGED_FROM_S:g} s"


def number(value: float) -> float | None:
    """Return a number for JSON: None for NaN and infinity."""
    return float(value) if math.isfinite(value) else None


def cm(value_m: float) -> str:
    """Length in m as text in cm."""
    if not np.isfinite(value_m):
        return "none"
    return f"{100 * value_m:.1f} cm" if abs(value_m) >= 0.01 else f"{100 * value_m:.2f} cm"


def with_error(value: float, error: float, text: Callable[[float], str] = "{:.2f}".format) -> str:
    """Text of a value with its standard error, if that is known."""
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


@dataclass(frozen=True, kw_only=True)
class Bar:
    """What is asked of a benchmark, and what was measured.

    Attributes:
        holds: whether it holds; None where it cannot be judged.
        not_judged: why it cannot be judged; empty where it can.
    """

    name: str
    asked: str
    measured: str
    holds: bool | None
    not_judged: str = ""

    @property
    def verdict(self) -> str:
        """Verdict in words."""
        return verdict_of(self.holds, self.not_judged)

    def as_json(self) -> dict[str, Any]:
        """Plain JSON values."""
        return {"name": self.name, "asked": self.asked, "measured": self.measured, "holds": self.holds}


def judged_bars(bars: Iterable[Bar], duration_s: float) -> list[Bar]:
    """Return bars of distances; none is judged on walks that are too short."""
    reason = too_short(duration_s)
    return [replace(bar, holds=None, not_judged=reason) if reason else bar for bar in bars]


def make_claim(
    name: str,
    measured: str,
    judgement: Judgement,
    *,
    values: Mapping[str, object] | None = None,
    beside: str = "",
    symmetric: str = "",
    null: str = "",
) -> Claim:
    """Return the claim of a short name with a judgement; `values` stand in the text of its rule."""
    text = texts("claims")[name]
    return Claim(
        claim=text["claim"],
        rule=text["rule"].format(**(values or {})),
        measured=measured,
        beside=beside,
        holds=judgement.holds,
        not_judged=judgement.not_judged,
        no_evidence=judgement.no_evidence,
        symmetric=symmetric,
        null=null,
    )


def verdict_lines(verdicts: Iterable[tuple[str, str]]) -> list[str]:
    """Verdicts in a column before their statements; reasons why there is none in lines of their own below."""
    pairs = [(verdict.partition(": "), statement) for verdict, statement in verdicts]
    lines = [f"{verdict:<15} {statement}" for (verdict, _, _), statement in pairs]
    reasons = dict.fromkeys(f"{verdict}: {reason}" for (verdict, _, reason), _ in pairs if reason)
    return [*lines, *reasons]


def bar_lines(bars: Iterable[Bar]) -> list[str]:
    """Verdicts of a benchmark's bars, each with what was asked and measured."""
    return verdict_lines((bar.verdict, f"{bar.asked}: {bar.measured}") for bar in bars)
