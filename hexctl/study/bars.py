"""The project's own bar: how near, after how few evaluations, on the mean over legs and runs."""

from dataclasses import dataclass
from statistics import fmean

from hexctl.study.findings import Findings

#: After 20 evaluations the mean is to be within 10 cm.
EARLY, EARLY_M = 20, 0.10

#: After 60 within 2.5 cm, or within 1 cm of the best gait that there is where that is not within 2.5 cm.
LATE, LATE_M, LATE_ABOVE_BEST_M = 60, 0.025, 0.01


@dataclass(frozen=True, kw_only=True)
class BarRow:
    """One optimizer against the bar at one number of evaluations.

    Attributes:
        optimizer: its name.
        paper_count: which count of evaluations.
        evaluations: 20 or 60.
        leg: the leg, or None for all legs together.
        mean_m: mean best-so-far over the runs that have found a valid gait; NaN when there is none.
        limit_m: the bar.
        share: of the runs that are in the mean.
    """

    optimizer: str
    paper_count: bool
    evaluations: int
    leg: int | None
    mean_m: float
    limit_m: float
    share: float

    @property
    def over_m(self) -> float:
        """Return by how much the bar is missed; negative where it is held."""
        return self.mean_m - self.limit_m

    @property
    def holds(self) -> bool:
        """Return whether the bar is held; a mean of nothing does not."""
        return bool(self.over_m <= 0)


def limit_m(findings: Findings, evaluations: int, leg: int | None) -> float:
    """Return the bar of a leg, or the mean of the legs' bars."""
    if evaluations == EARLY:
        return EARLY_M
    if leg is None:
        return fmean(limit_m(findings, evaluations, each) for each in findings.plan.legs)
    best = findings.rotated(leg).best_m
    return best + LATE_ABOVE_BEST_M if best > LATE_M else LATE_M


def bar_rows(findings: Findings, *, paper_count: bool) -> list[BarRow]:
    """Return every optimizer against every bar that the budget reaches: all legs together, then each."""
    return [
        _row(findings, optimizer, evaluations, leg, paper_count)
        for optimizer in findings.plan.optimizers
        for evaluations in (EARLY, LATE)
        if evaluations <= findings.plan.budget
        for leg in (None, *findings.plan.legs)
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
    )
