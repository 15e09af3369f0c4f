"""The claims of the paper, each with its rule, the numbers measured, and one of three verdicts.

A claim holds, does not hold, or there is no evidence: because the numbers decide nothing, because a symmetry
implies it, or because it holds on random numbers as well. What cannot be measured is not judged. Here are the
claims about searches; those about trajectories are in `hexctl.study.verdicts.trajectories`.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

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
    budget, best = findings.plan.budget, [findings.rotated(group[0]).best_m for group in findings.experiments]
    enough = [measure] if every.size and budget >= LATE else []
    return make_claim(
        "ends at 2.5 cm",
        f"{measures_text([measure], share_text, MORE_THAN_HALF)} after {budget} evaluations; {low} of "
        f"{every.size} below, {high} above; median case {cm(_median(every))}",
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


def _median(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else float("nan")


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
