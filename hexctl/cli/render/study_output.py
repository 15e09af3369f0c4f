"""Studies in the terminal: verdicts, bars that are missed, and the time spent."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hexctl.study.study import StudyResult
    from hexctl.study.verdicts.claim_evidence import Bar


def _verdict_lines(verdicts: Iterable[tuple[str, str]]) -> list[str]:
    """Verdicts in a column before their statements; reasons why there is none in lines of their own below."""
    pairs = [(verdict.partition(": "), statement) for verdict, statement in verdicts]
    lines = [f"{verdict:<15} {statement}" for (verdict, _, _), statement in pairs]
    reasons = dict.fromkeys(f"{verdict}: {reason}" for (verdict, _, reason), _ in pairs if reason)
    return [*lines, *reasons]


def bar_lines(bars: Iterable["Bar"]) -> list[str]:
    """Verdicts of a benchmark's bars, each with what was asked and measured."""
    return _verdict_lines((bar.verdict, f"{bar.asked}: {bar.measured}") for bar in bars)


def study_lines(result: "StudyResult") -> list[str]:
    """Claims, bars that are missed, and the time spent."""
    from hexctl.study.verdicts.claim_evidence import cm
    from hexctl.study.verdicts.distance_criterion import bar_rows

    findings = result.findings
    lines = _verdict_lines((claim.verdict, claim.claim) for claim in result.claims)
    rows = [row for row in bar_rows(findings, paper_count=False) if row.leg is None and row.holds is not None]
    missed = [row for row in rows if not row.holds]
    lines += [
        f"bar missed: {row.optimizer} {cm(row.mean_m)} after {row.evaluations} evaluations, "
        f"{cm(row.over_m)} over"
        for row in missed
    ]
    if rows and not missed:
        lines.append("bar held by all optimizers, each gait paid for once")
    lines += result.uncertainty.lines
    return [*lines, ", ".join(f"{name} {spent_s:.0f} s" for name, spent_s in result.times_s.items())]
