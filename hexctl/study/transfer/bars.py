"""The bars of the transfer benchmark."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from hexctl.adapt.catalogue import BAYES
from hexctl.study.claim import cm
from hexctl.study.plan import BASELINE
from hexctl.study.transfer.findings import NEAR_M, NEARER_M, TransferFindings

#: Mean deviation over all worlds and legs, and the trials within which it is asked; then the stretch.
ASKED = ((NEAR_M, 4, 2), (NEARER_M, 10, 6))

#: In worlds unlike the prior's, so many trials more than random search at most.
MORE_THAN_RANDOM = 2

#: Share of outcomes that shall lie in their intervals for nine of ten.
COVERAGE = (0.80, 0.97)


@dataclass(frozen=True, kw_only=True)
class Bar:
    """One bar.

    Attributes:
        name: stable name.
        asked: what is asked.
        measured: what was found.
        holds: whether it holds.
    """

    name: str
    asked: str
    measured: str
    holds: bool

    @property
    def verdict(self) -> str:
        """Return the verdict in words."""
        return "holds" if self.holds else "does not hold"

    def as_json(self) -> dict[str, Any]:
        """Return the bar as plain JSON values."""
        return {"name": self.name, "asked": self.asked, "measured": self.measured, "holds": self.holds}


def transfer_bars(findings: TransferFindings) -> list[Bar]:
    """Return the bars that the benchmark's optimizers and budget can tell of."""
    if BAYES not in findings.plan.optimizers or not findings.landscapes:
        return []
    bars = list(_means(findings))
    if BASELINE in findings.plan.optimizers:
        bars += _against_random(findings)
    share, outcomes = findings.coverage(BAYES, findings.places())
    low, high = COVERAGE
    bars.append(
        Bar(
            name="coverage",
            asked=f"{low:.0%} to {high:.0%} of outcomes in their intervals for nine of ten",
            measured=f"{share:.1%} of {outcomes}",
            holds=low <= share <= high,
        )
    )
    return bars


def _means(findings: TransferFindings) -> Iterator[Bar]:
    curves = findings.by_trials(BAYES, findings.places())
    for bound_m, within, stretch in ASKED:
        if within > findings.plan.budget:
            continue
        needed = curves.trials_to(bound_m)
        yield Bar(
            name=f"mean_{bound_m:g}_m",
            asked=f"mean within {cm(bound_m)} after {within} trials (stretch: {stretch})",
            measured=f"{_trials(needed)}; {cm(float(curves.mean[within - 1]))} after {within}",
            holds=needed is not None and needed <= within,
        )


def _against_random(findings: TransferFindings) -> Iterator[Bar]:
    """Compare with random search, kind by kind, wherever random search gets within the budget."""
    for kind in findings.kinds():
        places = findings.places(kind)
        bayes, random = (findings.by_trials(name, places) for name in (BAYES, BASELINE))
        for bound_m in (NEAR_M, NEARER_M):
            ours, theirs = bayes.trials_to(bound_m), random.trials_to(bound_m)
            if theirs is None and ours is None:
                continue  # out of reach of both
            yield Bar(
                name=f"{kind}_{bound_m:g}_m",
                asked=f"{kind}: mean within {cm(bound_m)}, {MORE_THAN_RANDOM} trials after random at most",
                measured=f"{_trials(ours)}, random {_trials(theirs)}",
                holds=ours is not None and (theirs is None or ours <= theirs + MORE_THAN_RANDOM),
            )


def _trials(count: int | None) -> str:
    return "not within the budget" if count is None else f"after {count}"
