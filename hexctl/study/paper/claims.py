"""Claims of the paper about searches: rules, numbers and verdicts, also on random numbers.

A claim holds, does not hold, or there is no evidence: the numbers decide nothing, a symmetry implies it, or
it holds on random numbers too. Claims about trajectories are in `hexctl.study.paper.trajectory_claims`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from hexctl.study.paper.evidence import (
    ABOUT,
    EARLY,
    EARLY_M,
    LATE,
    LATE_M,
    Claim,
    Measure,
    Tolerance,
    cm,
    judge_all,
    limit_text,
    measures_text,
    share_text,
    too_short,
)
from hexctl.study.paper.searches import NULL_DRAWS, Findings
from hexctl.study.paper.study_plan import BASELINE, HEURISTICS
from hexctl.study.paper.trajectory_claims import OF_WALKS, claim_of, experiment_text, make_claim
from hexctl.study.report_page import texts
from hexctl.types import FloatArray

if TYPE_CHECKING:
    from pandas import DataFrame, Series

MORE_THAN_HALF = Tolerance(float(np.nextafter(0.5, 1)), 1.0)

#: A curve has converged when it is this near to its last value.
CONVERGED_M = 0.005

#: Optimizers are competitive when the worst is this near to the best.
COMPETITIVE_M = 0.025

#: Share of the total improvement within the first 20 evaluations, for a curve with a flat end.
FAST = 0.8

#: A claim that holds in more than this share of draws of random numbers is no evidence.
NULL_SHARE = 0.05


@dataclass(frozen=True, eq=False)
class Searched:
    """Searches by which claims are judged: those of one leg of each experiment.

    On random numbers no other leg is searched: means over all legs would be compared with means over fewer.

    Attributes:
        best_m: best scores so far, a row for each run (world, leg, optimizer), a column for each evaluation.
    """

    findings: Findings
    best_m: "DataFrame"

    @classmethod
    def of(cls, findings: Findings, draw: int = 0) -> "Searched":
        """Return the searches in the landscapes, or in one draw of random numbers."""
        from pandas import DataFrame, MultiIndex

        runs, first = findings.runs, [group[0] for group in findings.experiments]
        runs = runs[(runs["draw"] == draw) & runs["leg"].isin(first)]
        best_m = np.reshape(runs["best_m"].to_list(), (len(runs), findings.plan.budget))
        return cls(findings, DataFrame(best_m, MultiIndex.from_frame(runs[["world", "leg", "optimizer"]])))

    @cached_property
    def cases(self) -> "DataFrame":
        """Mean of the runs of each world, leg and optimizer."""
        return self.best_m.groupby(level=["world", "leg", "optimizer"], sort=False).mean()

    @cached_property
    def votes(self) -> "DataFrame":
        """Mean curves by world and optimizer, one vote for each experiment, in m."""
        return self.cases.groupby(level=["world", "optimizer"], sort=False).mean()

    def vote(self, world: int, optimizer: str) -> FloatArray:
        """Return the mean curve of an optimizer in a world, (budget,), in m."""
        return np.asarray(self.votes.loc[(world, optimizer)], dtype=float)

    def ends(self, world: int) -> FloatArray:
        """Return the mean at the end of each case of a world: experiment and heuristic."""
        heuristics = self.cases.query(f"world == {world} and optimizer in {HEURISTICS}")
        return np.asarray(heuristics.iloc[:, -1], dtype=float)

    @cached_property
    def worst_best_m(self) -> "Series[float]":
        """Best run of the heuristic whose best run is worst, by world and leg; NaN if one found no gait."""
        ends_m = self.best_m.query(f"optimizer in {HEURISTICS}").iloc[:, -1]
        best_m = ends_m.groupby(level=["world", "leg", "optimizer"], sort=False).min()
        return best_m.groupby(level=["world", "leg"], sort=False).agg(lambda some: some.max(skipna=False))

    def per_heuristic(self, number: Callable[[FloatArray], float], most: float = np.inf) -> list[Measure]:
        """Return a number of each heuristic's mean curve, in each world."""
        findings = self.findings
        if not findings.heuristics:
            return []
        note = "" if np.isfinite(findings.rotated(findings.searched[0]).best_m) else "no valid gait"
        return [
            Measure(
                name, tuple(float(number(self.vote(world, name))) for world in findings.worlds), note, most
            )
            for name in findings.heuristics
        ]

    def random(self, evaluations: int) -> str:
        """Return the result of the random baseline after a number of evaluations in words."""
        curve = self.vote(0, BASELINE) if (0, BASELINE) in self.votes.index else np.zeros(0)
        mean_m = curve[evaluations - 1] if evaluations <= len(curve) else float("nan")
        return f"random: {cm(float(mean_m))} after {evaluations}"


def expected_best_rank(draws: int, codes: int = 120) -> float:
    """Expected rank of the best of some codes drawn without repetition: (codes + 1) / (draws + 1)."""
    return (codes + 1) / (min(draws, codes) + 1)


def _rank_text(evaluations: int) -> str:
    rank = expected_best_rank(evaluations)
    return f"expected best rank of {evaluations} random draws: {rank:.1f} of 120"


def _about_text(tolerance: Tolerance) -> str:
    limits = f"{limit_text(tolerance.low)} to {limit_text(tolerance.high)}"
    return f"{limits} (the paper's number ± {ABOUT:.0%})"


def converges(searched: Searched) -> Claim:
    """Claim about the values at the end of the curves."""
    findings, tolerance = searched.findings, Tolerance.about(LATE_M)
    budget = findings.plan.budget
    ends = [searched.ends(world) for world in findings.worlds]
    measure = Measure("of the cases", tuple(_share_within(values, tolerance) for values in ends), most=1.0)
    every = np.concatenate(ends)
    low, high = int((every < tolerance.low).sum()), int((every > tolerance.high).sum())
    known = every[np.isfinite(every)]
    median_m = float(np.median(known)) if known.size else float("nan")
    best = ", ".join(cm(findings.rotated(group[0]).best_m) for group in findings.experiments)
    return make_claim(
        "ends at 2.5 cm",
        f"{measures_text([measure], share_text, MORE_THAN_HALF)} after {budget} evaluations; {low} of "
        f"{every.size} below, {high} above; median case {cm(median_m)}",
        judge_all([measure] if every.size and budget >= LATE else [], MORE_THAN_HALF),
        beside=f"best of all gaits: {best}; {searched.random(budget)}",
        values={"about": _about_text(tolerance)},
    )


def _share_within(values: FloatArray, tolerance: Tolerance) -> float:
    if not np.isfinite(values).any():
        return float("nan")
    return float(((values >= tolerance.low) & (values <= tolerance.high)).mean())


def fast_then_flat(searched: Searched) -> Claim:
    """Claim about the shape of the curves."""
    enough = searched.findings.plan.budget > EARLY
    measures = searched.per_heuristic(_early_share, 1.0) if enough else []
    return claim_of("fast, then flat", measures, share_text, Tolerance(FAST, 1.0), values={"fast": FAST})


def _early_share(curve: FloatArray) -> float:
    """Share of a curve's improvement that its first 20 evaluations make."""
    first, early, last = curve[0], curve[EARLY - 1], curve[-1]
    return float((first - early) / (first - last)) if first > last else (1.0 if first == last else np.nan)


def minimal_by_60(searched: Searched) -> Claim:
    """Claim about when the curves stop falling."""
    tolerance, budget = Tolerance.about(40, LATE), searched.findings.plan.budget
    return claim_of(
        "40 to 60",
        searched.per_heuristic(_converged_after, budget) if budget > LATE else [],
        "{:.0f}".format,
        tolerance,
        beside=_rank_text(LATE),
        values={"low": tolerance.low, "high": tolerance.high, "about": ABOUT},
    )


def _converged_after(curve: FloatArray) -> float:
    if not np.isfinite(curve[-1]):
        return float("nan")
    return float(np.argmax(curve <= curve[-1] + CONVERGED_M) + 1)


def mean_after(searched: Searched, name: str, evaluations: int, about_m: float) -> Claim:
    """Claim about the mean of each heuristic after a number of evaluations."""
    tolerance, enough = Tolerance.about(about_m), evaluations <= searched.findings.plan.budget
    return claim_of(
        name,
        searched.per_heuristic(lambda curve: curve[evaluations - 1]) if enough else [],
        cm,
        tolerance,
        beside=f"{searched.random(evaluations)}; {_rank_text(evaluations)}",
        values={"evaluations": evaluations, "about": _about_text(tolerance)},
    )


def competitive(searched: Searched) -> Claim:
    """Claim about the differences between heuristics."""
    findings, measures = searched.findings, []
    if findings.plan.budget >= LATE and len(findings.heuristics) > 1:
        ends = [[searched.vote(world, name)[LATE - 1] for name in findings.heuristics]
                for world in findings.worlds]  # fmt: skip
        measures = [Measure("spread", tuple(float(np.ptp(some)) for some in ends))]
    return claim_of("competitive", measures, cm, Tolerance(high=COMPETITIVE_M), beside=searched.random(LATE))


def best_keep_line(searched: Searched) -> Claim:
    """Claim about the best trajectories."""
    findings, worst_m = searched.findings, searched.worst_best_m
    measures = [
        Measure(
            experiment_text(group),
            tuple(worst_m[world, group[0]] for world in findings.worlds),
            "no run found a valid gait" if np.isnan(worst_m[0, group[0]]) else "",
        )
        for group in (findings.experiments if findings.heuristics else ())
    ]
    before = "the heuristics' best runs, worst of them: "
    return claim_of("best keep the line", measures, cm, Tolerance(high=EARLY_M), before=before)


#: Claims about searches, which are tried on random numbers too.
OF_SEARCHES: tuple[Callable[[Searched], Claim], ...] = (
    converges,
    fast_then_flat,
    minimal_by_60,
    partial(mean_after, name="10 cm by 20", evaluations=EARLY, about_m=EARLY_M),
    partial(mean_after, name="2.5 cm by 60", evaluations=LATE, about_m=LATE_M),
    competitive,
    best_keep_line,
)

#: Short names of all claims, in the order of `claims_of`.
NAMES = tuple(texts("claims"))


def claims_of(findings: Findings) -> list[Claim]:
    """Return all claims in the paper's order; measured ones are not judged on too short walks."""
    searched = Searched.of(findings)
    nulls = [Searched.of(findings, draw) for draw in range(1, NULL_DRAWS + 1)]
    claims = [make(findings) for make in OF_WALKS]
    claims += [_against_null(make(searched), [make(null).holds for null in nulls]) for make in OF_SEARCHES]
    reason = too_short(findings.plan.duration_s)
    if not reason:
        return claims
    return [replace(claim, holds=None, no_evidence="", not_judged=reason)
            if claim.holds is not None or claim.no_evidence or claim.not_judged else claim
            for claim in claims]  # fmt: skip


def _against_null(claim: Claim, draws: list[bool | None]) -> Claim:
    """Claim without evidence if its rule holds on random numbers too."""
    claim = replace(claim, null=f"holds in {draws.count(True)} of {len(draws)} draws")
    if claim.holds and null_share(draws) > NULL_SHARE:
        return replace(claim, holds=None, no_evidence="also holds on random numbers")
    return claim


def null_share(holds: list[bool | None]) -> float:
    """Chance that a claim holds on random numbers, from draws of them: (k + 1) / (n + 1)."""
    return (holds.count(True) + 1) / (len(holds) + 1)
