"""Verdicts as lines of text."""

from collections.abc import Iterable

from hexctl.study.verdicts.claim_evidence import Bar


def verdict_lines(verdicts: Iterable[tuple[str, str]]) -> list[str]:
    """Verdicts in a column before their statements; reasons why there is none in lines of their own below."""
    pairs = [(verdict.partition(": "), statement) for verdict, statement in verdicts]
    lines = [f"{verdict:<15} {statement}" for (verdict, _, _), statement in pairs]
    reasons = dict.fromkeys(f"{verdict}: {reason}" for (verdict, _, reason), _ in pairs if reason)
    return [*lines, *reasons]


def bar_lines(bars: Iterable[Bar]) -> list[str]:
    """Verdicts of a benchmark's bars, each with what was asked and measured."""
    return verdict_lines((bar.verdict, f"{bar.asked}: {bar.measured}") for bar in bars)
