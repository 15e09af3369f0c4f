"""The project's own bar: how near the line every optimizer is to be after 20 and after 60 evaluations."""

from collections.abc import Iterator
from dataclasses import dataclass
from statistics import fmean

from hexctl.study.searches import Findings
from hexctl.study.verdicts.claim_evidence import EARLY, EARLY_M, LATE, LATE_M, cm, too_short, verdict_of

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
