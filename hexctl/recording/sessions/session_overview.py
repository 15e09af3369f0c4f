"""The overview of a session: its values, and the table of its trials."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hexctl.types import ArrayFields, FloatArray

#: Unit of scores with the dimension of a length; they are shown in cm.
METRES = "m"

#: Points further away come from a diverged simulation and are not drawn.
FAR_M = 1000.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OverviewTrial(ArrayFields):
    """One trial.

    Attributes:
        score_m: by the session's objective, lower is better; None for an invalid trial.
        deviation_m: final deviation, positive to the left; None if unknown.
        path_m: progress along the heading and signed deviation, positive to the left, (N, 2).
        address: URL of its recording, which a viewer opens, or None.
        gait: shown instead of the code; None shows the code.
    """

    index: int
    code: int
    slots: tuple[int, ...]
    score_m: float | None
    deviation_m: float | None
    distance_m: float | None
    status: str
    path_m: FloatArray
    address: str | None = None
    gait: str | None = None

    @property
    def end_m(self) -> FloatArray:
        """Last point of the path, (2,)."""
        end: FloatArray = self.path_m[-1]
        return end


@dataclass(frozen=True, slots=True, kw_only=True)
class Overview:
    """A session for its overview.

    Attributes:
        course_m: distance of a walk without slip.
        baseline: never the best trial.
    """

    title: str
    facts: tuple[str, ...]
    objective: str
    unit: str = METRES
    course_m: float
    trials: tuple[OverviewTrial, ...]
    baseline: tuple[OverviewTrial, ...] = ()

    @property
    def curve_factor(self) -> float:
        """Factor of the scores in a plot."""
        return 100.0 if self.unit == METRES else 1.0

    @property
    def curve_unit(self) -> str:
        """Unit of the scores in a plot."""
        return "cm" if self.unit == METRES else self.unit

    @property
    def best(self) -> OverviewTrial | None:
        """Trial with the lowest score, the earliest of equals; None without a valid trial."""
        return list(self.best_so_far())[-1] if self.trials else None

    def best_so_far(self) -> Iterator[OverviewTrial | None]:
        """For each trial the best one so far; None before the first valid one."""
        best, lowest_m = None, math.inf
        for trial in self.trials:
            if trial.score_m is not None and trial.score_m < lowest_m:
                best, lowest_m = trial, trial.score_m
            yield best


def deviation_text(deviation_m: float | None) -> str:
    """Signed deviation as text, such as `0.6 cm left`."""
    if deviation_m is None or not math.isfinite(deviation_m):
        return "-"
    return f"{100 * abs(deviation_m):.1f} cm {'left' if deviation_m > 0 else 'right'}"


def score_text(score: float, unit: str) -> str:
    """Score with its unit; m become cm."""
    return f"{100 * score:.1f} cm" if unit == METRES else f"{score:.3f} {unit}".rstrip()


def mark_text(length_m: float) -> str:
    """A round length as text, such as `2.5 cm` and `3 m`."""
    return f"{100 * length_m:g} cm" if length_m < 1 else f"{length_m:g} m"


def drawable(path_m: FloatArray) -> FloatArray:
    """Finite points of a path, (N, 2) in m, near enough to draw."""
    sane = np.nan_to_num(np.abs(path_m), nan=np.inf) < FAR_M
    kept: FloatArray = path_m[np.all(sane, axis=1)]
    return kept


COLUMNS = ("trial", "code", "slots", "deviation", "distance", "status", "best so far")


def make_table(overview: Overview) -> str:
    """Markdown: title, facts, and a row per trial with the best one in bold."""
    best = overview.best
    rows = [_row(_cells(walk, None, overview.unit), bold=False) for walk in overview.baseline]
    rows += [
        _row(_cells(trial, so_far, overview.unit), bold=trial is best)
        for trial, so_far in zip(overview.trials, overview.best_so_far(), strict=True)
    ]
    facts = "\n".join(f"- {fact}" for fact in (*overview.facts, *_how_to_open(overview)))
    head = [_row(COLUMNS, bold=False), "|--:|--:|---|--:|--:|---|--:|"]
    return "\n".join([f"## {overview.title}", "", facts, "", *head, *rows]) + "\n"


def _how_to_open(overview: Overview) -> tuple[str, ...]:
    if not any(trial.address for trial in (*overview.baseline, *overview.trials)):
        return ()
    return ("click ▶ to see a trial walk; ← at the top comes back",)


def _cells(trial: OverviewTrial, best: OverviewTrial | None, unit: str) -> tuple[str, ...]:
    distance = "-" if trial.distance_m is None else f"{trial.distance_m:.2f} m"
    so_far = "-" if best is None or best.score_m is None else score_text(best.score_m, unit)
    slots = ",".join(str(slot) for slot in trial.slots)
    off = deviation_text(trial.deviation_m)
    number = str(trial.index) if trial.address is None else f"[▶ {trial.index}]({trial.address})"
    return number, trial.gait or str(trial.code), slots, off, distance, trial.status, so_far


def _row(cells: tuple[str, ...], *, bold: bool) -> str:
    return "| " + " | ".join(f"**{cell}**" if bold else cell for cell in cells) + " |"
