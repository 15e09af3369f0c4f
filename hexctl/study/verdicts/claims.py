"""The claims of the paper, each with its rule, the numbers measured, and one of three verdicts.

A claim holds, does not hold, or there is no evidence: because the numbers decide nothing, because a symmetry
implies it, or because it holds on random numbers as well. What cannot be measured is not judged. Here are the
claims about searches; those about trajectories are in `hexctl.study.verdicts.trajectories`.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from statistics import fmean

import numpy as np

from hexctl.study.reports.texts import texts
from hexctl.study.searches import BASELINE, Findings, mean_of
from hexctl.study.verdicts.claim_evidence import (
    ABOUT,
    EARLY,
    EARLY_M,
    LATE,
    LATE_M,
    NULL_SHARE,
    Claim,
    Measure,
    Tolerance,
    cm,
    judge_all,
    limit_text,
    make_claim,
    measures_text,
    null_share,
    share_text,
    too_short,
    verdict_of,
)
from hexctl.study.verdicts.trajectories import (
    experiment_text,
    goes_both_ways,
    rotation_helps,
    rotation_straightens,
    veers_left,
    veers_right,
)
from hexctl.types import FloatArray

MORE_THAN_HALF = Tolerance(float(np.nextafter(0.5, 1)), 1.0)


#: A curve has converged when it is this near to its last value.
CONVERGED_M = 0.005

#: Optimizers are competitive when the worst is this near to the best.
COMPETITIVE_M = 0.025

#: Share of the whole improvement that the first 20 evaluations of a curve that is flat after them make.
FAST = 0.8


def expected_best_rank(draws: int, codes: int = 120) -> float:
    """Expected rank of the best of some codes drawn without repetition: (codes + 1) / (draws + 1)."""
    return (codes + 1) / (min(draws, codes) + 1)


def _about(low: float, high: float | None = None) -> tuple[Tolerance, str]:
    """Tolerance of "about" a length in m, and its text."""
    tolerance = Tolerance.about(low, high)
    return (
        tolerance,
        f"{limit_text(tolerance.low)} to {limit_text(tolerance.high)} (the paper's number ± {ABOUT:.0%})",
    )


def converges(findings: Findings) -> Claim:
    """Claim about the values at the end of the curves."""
    tolerance, text = _about(LATE_M)
    finals = [_finals(world) for world in findings.worlds]
    measure = Measure("of the cases", tuple(_share_within(values, tolerance) for values in finals), most=1.0)
    every = np.concatenate(finals) if finals else np.zeros(0)
    low, high = int((every < tolerance.low).sum()), int((every > tolerance.high).sum())
    known = every[np.isfinite(every)]
    median_m = float(np.median(known)) if known.size else float("nan")
    budget, best = findings.plan.budget, [findings.rotated(group[0]).best_m for group in findings.experiments]
    enough = [measure] if every.size and budget >= LATE else []
    return make_claim(
        "ends at 2.5 cm",
        f"{measures_text([measure], share_text, MORE_THAN_HALF)} after {budget} evaluations; {low} of "
        f"{every.size} below, {high} above; median case {cm(median_m)}",
        judge_all(enough, MORE_THAN_HALF),
        beside=f"best of all gaits: {', '.join(map(cm, best))}; {_random(findings, budget)}",
        values={"about": text},
    )


def _finals(findings: Findings) -> FloatArray:
    """Mean at the end of each case: experiment and heuristic."""
    return np.array(
        [
            mean_of(np.concatenate([findings.searches[leg, name, True].best_m for leg in group]))[-1]
            for group in findings.experiments
            for name in findings.heuristics
        ],
        dtype=float,
    )


def _share_within(values: FloatArray, tolerance: Tolerance) -> float:
    if not np.isfinite(values).any():
        return float("nan")
    return float(((values >= tolerance.low) & (values <= tolerance.high)).mean())


def _per_heuristic(
    findings: Findings, number: Callable[[FloatArray], float], most: float = np.inf
) -> list[Measure]:
    """A number of each heuristic's mean curve, in each world."""
    if not findings.heuristics:  # in random numbers nothing was searched then
        return []
    note = "" if np.isfinite(findings.rotated(findings.searched[0]).best_m) else "no valid gait"
    return [
        Measure(name, tuple(float(number(world.voted_curve(name))) for world in findings.worlds), note, most)
        for name in findings.heuristics
    ]


def fast_then_flat(findings: Findings) -> Claim:
    """Claim about the shape of the curves."""
    tolerance = Tolerance(FAST, 1.0)
    measures = _per_heuristic(findings, _early_share, 1.0) if findings.plan.budget > EARLY else []
    return make_claim(
        "fast, then flat",
        measures_text(measures, share_text, tolerance),
        judge_all(measures, tolerance),
        values={"fast": FAST},
    )


def _early_share(curve: FloatArray) -> float:
    """Share of a curve's improvement that its first 20 evaluations make."""
    first, early, last = curve[0], curve[EARLY - 1], curve[-1]
    return float((first - early) / (first - last)) if first > last else (1.0 if first == last else np.nan)


def minimal_by_60(findings: Findings) -> Claim:
    """Claim about when the curves stop falling."""
    tolerance = Tolerance.about(40, LATE)
    measures = (
        _per_heuristic(findings, _converged_after, findings.plan.budget)
        if findings.plan.budget > LATE
        else []
    )
    return make_claim(
        "40 to 60",
        measures_text(measures, lambda count: f"{count:.0f}", tolerance),
        judge_all(measures, tolerance),
        beside=f"expected best rank of {LATE} random draws: {expected_best_rank(LATE):.1f} of 120",
        values={"low": tolerance.low, "high": tolerance.high, "about": ABOUT},
    )


def _converged_after(curve: FloatArray) -> float:
    if not np.isfinite(curve[-1]):
        return float("nan")
    return float(np.argmax(curve <= curve[-1] + CONVERGED_M) + 1)


def ten_cm_by_20(findings: Findings) -> Claim:
    """Claim about the first 20 evaluations."""
    return _mean_claim(findings, "10 cm by 20", EARLY, EARLY_M)


def late_mean(findings: Findings) -> Claim:
    """Claim of the abstract about 40 to 60 evaluations."""
    return _mean_claim(findings, "2.5 cm by 60", LATE, LATE_M)


def _mean_claim(findings: Findings, name: str, evaluations: int, about_m: float) -> Claim:
    """Claim about the mean of each heuristic after a number of evaluations."""
    tolerance, text = _about(about_m)
    enough = evaluations <= findings.plan.budget
    measures = _per_heuristic(findings, lambda curve: curve[evaluations - 1]) if enough else []
    return make_claim(
        name,
        measures_text(measures, cm, tolerance),
        judge_all(measures, tolerance),
        beside=f"{_random(findings, evaluations)}; expected best rank of {evaluations} random draws: "
        f"{expected_best_rank(evaluations):.1f} of 120",
        values={"evaluations": evaluations, "about": text},
    )


def competitive(findings: Findings) -> Claim:
    """Claim about the differences between heuristics."""
    tolerance = Tolerance(high=COMPETITIVE_M)
    measures = []
    if findings.plan.budget >= LATE and len(findings.heuristics) > 1:
        spreads = [np.ptp([one.voted_curve(name)[LATE - 1] for name in one.heuristics])
                   for one in findings.worlds]  # fmt: skip
        measures = [Measure("spread", tuple(float(spread) for spread in spreads))]
    return make_claim(
        "competitive",
        measures_text(measures, cm, tolerance),
        judge_all(measures, tolerance),
        beside=_random(findings, LATE),
    )


def best_keep_line(findings: Findings) -> Claim:
    """Claim about the best trajectories."""
    tolerance = Tolerance(high=EARLY_M)
    measures = [
        Measure(
            experiment_text(findings, group),
            tuple(_worst_best_m(world, group) for world in findings.worlds),
            "no run found a valid gait" if np.isnan(_worst_best_m(findings, group)) else "",
        )
        for group in (findings.experiments if findings.heuristics else ())
    ]
    return make_claim(
        "best keep the line",
        "the heuristics' best runs, worst of them: " + measures_text(measures, cm, tolerance),
        judge_all(measures, tolerance),
    )


def _worst_best_m(findings: Findings, group: Sequence[int]) -> float:
    """Best run of the heuristic whose best run is worst, in m; NaN when one has no valid gait."""
    best = [
        np.nanmin(findings.searches[leg, name, True].best_m[:, -1], initial=np.inf)
        for leg in group
        if leg in findings.searched
        for name in findings.heuristics
    ]
    worst = max(best, default=np.nan)
    return float(worst) if np.isfinite(worst) else float("nan")


def _random(findings: Findings, evaluations: int) -> str:
    """The random baseline after a number of evaluations."""
    known = evaluations <= findings.plan.budget
    mean_m = findings.voted_curve(BASELINE)[evaluations - 1] if known else float("nan")
    return f"random: {cm(float(mean_m))} after {evaluations}"


#: Claims about the robot, and claims about searches, which are tried on random numbers, too.
OF_WALKS = (veers_left, veers_right, goes_both_ways, rotation_straightens, rotation_helps)
OF_SEARCHES = (
    converges, fast_then_flat, minimal_by_60, ten_cm_by_20, late_mean, competitive, best_keep_line
)  # fmt: skip

#: Short names of all claims, in the order of `claims_of`.
NAMES = tuple(texts("claims"))


def claims_of(findings: Findings) -> list[Claim]:
    """All claims in the paper's order; walks that are too short leave those that were measured not judged."""
    claims = [make(findings) for make in OF_WALKS]
    claims += [_against_null(make, findings.judged) for make in OF_SEARCHES]
    reason = too_short(findings.plan.duration_s)
    if not reason:
        return claims
    return [replace(claim, holds=None, no_evidence="", not_judged=reason)
            if claim.holds is not None or claim.no_evidence or claim.not_judged else claim
            for claim in claims]  # fmt: skip


def _against_null(make: Callable[[Findings], Claim], findings: Findings) -> Claim:
    """Claim about searches beside the same rule on random numbers: what holds on those, too, says nothing."""
    claim = make(findings)
    draws = [make(null).holds for null in findings.nulls]
    claim = replace(claim, null=f"holds in {draws.count(True)} of {len(draws)} draws")
    if claim.holds and null_share(draws) > NULL_SHARE:
        return replace(claim, holds=None, no_evidence="also holds on random numbers")
    return claim


#: Where no gait is within `LATE_M`, the bar is this much above the best gait that there is.
LATE_ABOVE_BEST_M = 0.01


@dataclass(frozen=True, kw_only=True)
class BarRow:
    """One optimizer against the bar at one number of evaluations.

    Attributes:
        paper_count: which count of evaluations.
        evaluations: 20 or 60.
        leg: the leg, or None for all legs together.
        mean_m: mean best-so-far over the runs that have found a valid gait; NaN when there is none.
        share: of the runs that are in the mean.
        not_judged: why the mean cannot be judged; empty where it can.
    """

    optimizer: str
    paper_count: bool
    evaluations: int
    leg: int | None
    mean_m: float
    limit_m: float
    share: float
    not_judged: str = ""

    @property
    def over_m(self) -> float:
        """Excess of the mean over the bar, in m; negative within the bar."""
        return self.mean_m - self.limit_m

    @property
    def holds(self) -> bool | None:
        """Whether the mean is within the bar; False without any mean, None where it cannot be judged."""
        return None if self.not_judged else bool(self.over_m <= 0)

    @property
    def verdict(self) -> str:
        """Verdict in words, with the excess."""
        missed = f", by {cm(self.over_m)}" if self.holds is False else ""
        return verdict_of(self.holds, self.not_judged) + missed


def limit_m(findings: Findings, evaluations: int, leg: int | None) -> float:
    """Bar of a leg in m, or the mean of the legs' bars."""
    if evaluations == EARLY:
        return EARLY_M
    if leg is None:
        return fmean(limit_m(findings, evaluations, each) for each in findings.searched)
    best = findings.rotated(leg).best_m
    return best + LATE_ABOVE_BEST_M if best > LATE_M else LATE_M


def bar_rows(findings: Findings, *, paper_count: bool) -> list[BarRow]:
    """Every optimizer against every bar within the budget: all legs together, then each leg."""
    return [
        _row(findings, optimizer, evaluations, leg, paper_count)
        for optimizer in findings.plan.optimizers
        for evaluations in (EARLY, LATE)
        if evaluations <= findings.plan.budget
        for leg in (None, *findings.searched)
    ]


def _row(findings: Findings, optimizer: str, evaluations: int, leg: int | None, paper_count: bool) -> BarRow:
    if leg is None:
        curve = findings.mean_curve(optimizer, paper_count=paper_count)
    else:
        curve = findings.searches[leg, optimizer, paper_count].curve
    return BarRow(
        optimizer=optimizer,
        paper_count=paper_count,
        evaluations=evaluations,
        leg=leg,
        mean_m=float(curve.mean[evaluations - 1]),
        limit_m=limit_m(findings, evaluations, leg),
        share=float(curve.share[evaluations - 1]),
        not_judged=too_short(findings.plan.duration_s),
    )


def missed_lines(findings: Findings) -> Iterator[str]:
    """Optimizers that miss the bar for distances, or that none does."""
    rows = [row for row in bar_rows(findings, paper_count=False) if row.leg is None and row.holds is not None]
    missed = [row for row in rows if not row.holds]
    for row in missed:
        yield (
            f"bar missed: {row.optimizer} {cm(row.mean_m)} after {row.evaluations} evaluations, "
            f"{cm(row.over_m)} over"
        )
    if rows and not missed:
        yield "bar held by all optimizers, each gait paid for once"
