"""Ours against a reference: in alternation, so that whatever else the machine does hits both alike."""

from collections.abc import Callable, Sequence
from statistics import median
from typing import TypeVar

Measured = TypeVar("Measured")


def alternate(
    ours: Callable[[], Measured], bare: Callable[[], Measured], rounds: int
) -> list[tuple[Measured, Measured]]:
    """Return what ours and the reference measured in each round; who goes first changes every round."""
    pairs = []
    for index in range(rounds):
        if index % 2:
            of_bare = bare()
            pairs.append((ours(), of_bare))
        else:
            of_ours = ours()
            pairs.append((of_ours, bare()))
    return pairs


def median_ratio(pairs: Sequence[tuple[float, float]]) -> float:
    """Return the median over the rounds of our times divided by the reference."""
    return median(ours / bare for ours, bare in pairs)


def spread(pairs: Sequence[tuple[float, float]]) -> str:
    """Return the smallest and the largest ratio of any round, as text for a note."""
    ratios = [ours / bare for ours, bare in pairs]
    return f"{min(ratios):.3f}..{max(ratios):.3f} over {len(ratios)} rounds"
