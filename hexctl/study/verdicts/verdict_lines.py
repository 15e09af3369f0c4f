"""Verdicts as lines of text."""

from collections.abc import Iterable, Iterator

from hexctl.study.searches import Findings
from hexctl.study.verdicts.claim_evidence import Bar, cm
from hexctl.study.verdicts.distance_criterion import bar_rows


def verdict_lines(verdicts: Iterable[tuple[str, str]]) -> list[str]:
    """Verdicts in a column before their statements; reasons why there is none in lines of their own below."""
    pairs = [(verdict.partition(": "), statement) for verdict, statement in verdicts]
    lines = [f"{verdict:<15} {statement}" for (verdict, _, _), statement in pairs]
    reasons = dict.fromkeys(f"{verdict}: {reason}" for (verdict, _, reason), _ in pairs if reason)
    return [*lines, *reasons]


def bar_lines(bars: Iterable[Bar]) -> list[str]:
    """Verdicts of a benchmark's bars, each with what was asked and measured."""
    return verdict_lines((bar.verdict, f"{bar.asked}: {bar.measured}") for bar in bars)


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
