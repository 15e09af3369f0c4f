"""What a benchmark reports: one value, its unit, the bar it has to clear and whether it does."""

from dataclasses import dataclass
from typing import Any

from scipy.stats import binomtest

#: Digits of a value that mean anything on a machine that does other things too.
SIGNIFICANT_DIGITS = 4


@dataclass(frozen=True, slots=True)
class Bar:
    """The range that a value must lie in; None is no limit on that side."""

    low: float | None = None
    high: float | None = None

    def __str__(self) -> str:
        if self.low is None:
            return f"<= {self.high:g}"
        if self.high is None:
            return f">= {self.low:g}"
        return f"{self.low:g}..{self.high:g}"

    def holds(self, value: float) -> bool:
        """Return whether a value lies in the range."""
        return (self.low is None or value >= self.low) and (self.high is None or value <= self.high)


@dataclass(frozen=True, slots=True)
class Row:
    """One measured figure.

    Attributes:
        name: the name of its benchmark, and after a dot what of it.
        value: the figure, None where there is none.
        unit: its unit, `ratio` for ours over the reference.
        bar: what it has to clear; None for a figure that only informs.
        note: how it came about.
    """

    name: str
    value: float | None
    unit: str
    bar: Bar | None = None
    note: str = ""

    @property
    def holds(self) -> bool | None:
        """Return whether the bar holds, None without a bar."""
        if self.bar is None:
            return None
        return self.value is not None and self.bar.holds(self.value)

    def __str__(self) -> str:
        verdict = {None: "", True: "holds", False: "FAILS"}[self.holds]
        bar = "" if self.bar is None else str(self.bar)
        return f"{self.name:<40} {self.shown:>10} {self.unit:<8} {bar:<10} {verdict:<6} {self.note}"

    def as_json(self) -> dict[str, Any]:
        """Return the row as plain JSON values."""
        return {
            "name": self.name,
            "value": None if self.value is None else float(self.shown),
            "unit": self.unit,
            "bar": None if self.bar is None else str(self.bar),
            "holds": self.holds,
            "note": self.note,
        }

    @property
    def shown(self) -> str:
        """Return the value as text without digits that mean nothing."""
        return "-" if self.value is None else f"{self.value:.{SIGNIFICANT_DIGITS}g}"


@dataclass(frozen=True, slots=True)
class Count:
    """Robots of one kind: for how many of them something holds."""

    holding: int
    of: int

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's interval of the share, 95 %."""
        if not self.of:
            return 0.0, 1.0
        found = binomtest(self.holding, self.of).proportion_ci(method="wilson")
        return float(found.low), float(found.high)

    def row(self, name: str, what: str) -> Row:
        """The share, with its interval and what holds."""
        low, high = self.interval
        note = f"{self.holding} of {self.of} {what}, 95 % interval {low:.2f} to {high:.2f}"
        return Row(name, self.holding / self.of if self.of else None, "share", note=note)
