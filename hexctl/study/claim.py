"""One claim of the paper, and how its numbers are written."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Claim:
    """A claim of the paper and what this study says of it.

    Attributes:
        claim: what the paper says.
        rule: when it counts as held here.
        measured: the numbers, with how far off where it does not hold.
        beside: what the random baseline does, or another fact to read it with.
        holds: None where this study did not measure it.
    """

    claim: str
    rule: str
    measured: str
    beside: str
    holds: bool | None

    @property
    def verdict(self) -> str:
        """Return the verdict in words."""
        return {True: "holds", False: "does not hold", None: "not measured"}[self.holds]


def per_leg(legs: Sequence[int], values: Sequence[str]) -> str:
    """Return one text per leg as one line."""
    return "; ".join(f"leg {leg}: {value}" for leg, value in zip(legs, values, strict=True)) or "no such leg"


def each(values: dict[str, str]) -> str:
    """Return one text per optimizer as one line."""
    return ", ".join(f"{name} {value}" for name, value in values.items()) or "not within the budget"


def cm(value_m: float) -> str:
    """Return a length in m as text in cm."""
    if not np.isfinite(value_m):
        return "none"
    return f"{100 * value_m:.1f} cm" if abs(value_m) >= 0.01 else f"{100 * value_m:.2f} cm"
