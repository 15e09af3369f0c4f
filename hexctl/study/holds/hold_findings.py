"""What the compared walks show: statistics of groups of them, and bars."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexctl.study.holds.hold_conditions import HOLDS, INTACT, HoldConditions
from hexctl.study.holds.hold_plan import HoldPlan
from hexctl.study.holds.hold_walks import HoldWalk
from hexctl.study.verdicts.claim_evidence import Bar, clustered_error, cm, limit_text, too_short
from hexctl.types import BoolArray, FloatArray

#: The family of worlds with robots as they are built, in which intact robots are judged.
REAL = "real"

#: Share of walks that may make no progress.
NO_PROGRESS = 0.03


@dataclass(frozen=True, kw_only=True)
class HoldStatistics:
    """Statistics of some walks with one hold; standard errors are over worlds, NaN for a single one.

    A walk that fell, diverged or was stopped has no deviation; one without progress has.

    Attributes:
        walks: number of walks.
        worlds: number of worlds.
        mean_m: mean of the final deviation.
        mean_error_m: its standard error.
        p90_m: 90th percentile of the final deviation.
        max_m: greatest one.
        way_p90_m: 90th percentile of the greatest deviation on the way.
        no_progress: walks without progress.
        fell: walks that fell.
        others: walks that diverged or were stopped.
        over_ideal: mean progress as a share of the ideal.
        over_ideal_error: its standard error.
        over_open: progress over that of the same walks open loop, both summed; NaN without any.
        over_open_error: its standard error.
    """

    walks: int
    worlds: int
    mean_m: float
    mean_error_m: float
    p90_m: float
    max_m: float
    way_p90_m: float
    no_progress: int
    fell: int
    others: int
    over_ideal: float
    over_ideal_error: float
    over_open: float
    over_open_error: float


@dataclass(frozen=True, kw_only=True)
class HoldFindings:
    """The walks of a plan.

    Attributes:
        plan: what was walked.
        walks: each with its conditions, in the order of the plan.
    """

    plan: HoldPlan
    walks: Sequence[tuple[HoldConditions, HoldWalk]]

    @cached_property
    def _rows(self) -> "dict[str, HoldRows]":
        return {hold: HoldRows([pair for pair in self.walks if pair[1].case.hold == hold]) for hold in HOLDS}

    def rows(self, hold: str) -> "HoldRows":
        """Walks with one hold; those of any two holds are pairs, row by row."""
        return self._rows[hold]

    def groups(self) -> Iterator[tuple[str, str, BoolArray]]:
        """Name of a division, name of a group in it, and which rows are in it, (rows,).

        All divisions but that by failure leave intact robots out.
        """
        rows = self.rows(self.plan.holds[0])
        damaged = rows.failures != INTACT
        yield "all", "one leg failed", damaged
        for name in dict.fromkeys(rows.failures):
            yield "failure", str(name), rows.failures == name
        for title, values in (("robot", rows.robots), ("family", rows.families), ("leg", rows.legs)):
            for name in dict.fromkeys(values[damaged].tolist()):
                yield title, str(name), damaged & (values == name)
        for name in dict.fromkeys(rows.kinds):
            yield "kind of world", str(name), damaged & (rows.kinds == name)
        for name, which in (("even", ~rows.rough), ("rough", rows.rough)):
            if which.any():
                yield "floor", name, damaged & which

    def statistics(self, hold: str, which: BoolArray) -> HoldStatistics:
        """Statistics of the rows of a hold that are chosen by `which`, (rows,)."""
        rows = self.rows(hold)
        final_m, ended = rows.final_m[which], np.isfinite(rows.final_m[which])
        worlds, status = rows.worlds[which], rows.status[which]
        speed = rows.speed[which]
        over_open, over_open_error = float("nan"), float("nan")
        if "none" in self.plan.holds:
            open_loop_m = self.rows("none").distance_m[which]
            over_open, over_open_error = _ratio(rows.distance_m[which], open_loop_m, worlds)
        failing = [int((status == name).sum()) for name in ("no_progress", "fell")]
        return HoldStatistics(
            walks=len(final_m),
            worlds=len(np.unique(worlds)),
            mean_m=_mean(final_m[ended]),
            mean_error_m=float(clustered_error(final_m[ended], worlds[ended])),
            p90_m=_p90(final_m[ended]),
            max_m=_most(final_m[ended]),
            way_p90_m=_p90(rows.max_m[which][ended]),
            no_progress=failing[0],
            fell=failing[1],
            others=len(final_m) - int(ended.sum()) - failing[1],
            over_ideal=_mean(speed[ended]),
            over_ideal_error=float(clustered_error(speed[ended], worlds[ended])),
            over_open=over_open,
            over_open_error=over_open_error,
        )


class HoldRows:
    """Walks as columns, one row each.

    Args:
        walks: each with its conditions.
    """

    def __init__(self, walks: Sequence[tuple[HoldConditions, HoldWalk]]) -> None:
        places, self._walks = [place for place, _ in walks], [walk for _, walk in walks]
        self.robots = np.array([place.robot.name for place in places])
        self.families = np.array([place.family for place in places])
        self.worlds = np.array([f"{place.family}:{place.number}" for place in places])
        self.kinds = np.array([place.kind for place in places])
        self.rough: BoolArray = np.array([place.rough for place in places], dtype=bool)
        self.legs = np.array([walk.case.leg for walk in self._walks])
        self.failures = np.array([walk.case.failure for walk in self._walks])

    @cached_property
    def status(self) -> NDArray[np.str_]:
        """Statuses, (rows,)."""
        return np.array([walk.status for walk in self._walks])

    @cached_property
    def final_m(self) -> FloatArray:
        """Final deviations, (rows,); NaN for walks that did not end on their feet."""
        return np.array([walk.final_m for walk in self._walks])

    @cached_property
    def max_m(self) -> FloatArray:
        """Greatest deviations on the way, (rows,)."""
        return np.array([walk.max_m for walk in self._walks])

    @cached_property
    def speed(self) -> FloatArray:
        """Progress as shares of the ideal, (rows,); NaN likewise."""
        return np.array([walk.speed for walk in self._walks])

    @cached_property
    def distance_m(self) -> FloatArray:
        """Progress, (rows,); NaN likewise."""
        return self.speed * [walk.ideal_distance_m for walk in self._walks]


def _mean(values: FloatArray) -> float:
    return float(values.mean()) if values.size else float("nan")


def _most(values: FloatArray) -> float:
    return float(values.max()) if values.size else float("nan")


def _p90(values: FloatArray) -> float:
    return float(np.percentile(values, 90)) if values.size else float("nan")


def _ratio(above: FloatArray, below: FloatArray, worlds: NDArray[Any]) -> tuple[float, float]:
    """Sum of some values over that of others, pairs with NaN left out, and its standard error over worlds."""
    known = np.isfinite(above) & np.isfinite(below)
    above, below, worlds = above[known], below[known], worlds[known]
    if not known.any() or below.sum() <= 0:
        return float("nan"), float("nan")
    ratio = float(above.sum() / below.sum())
    return ratio, float(clustered_error((above - ratio * below) / below.mean(), worlds))


def hold_bars(findings: HoldFindings) -> list[Bar]:
    """Bars that the walks of a plan reach; none is judged on walks that are too short."""
    bars = [*_line_bars(findings), *_heading_bars(findings), *_intact_bars(findings)]
    reason = too_short(findings.plan.duration_s)
    return [replace(bar, holds=None, not_judged=reason) for bar in bars] if reason else bars


def _line_bars(findings: HoldFindings) -> Iterator[Bar]:
    if "line" not in findings.plan.holds:
        return
    groups = {(division, name): which for division, name, which in findings.groups()}
    found = findings.statistics("line", groups["all", "one leg failed"])
    yield _length("line_mean", "pose: mean of the final deviation", found.mean_m, 0.006, 0.003)
    yield _length("line_p90", "pose: nine of ten final deviations", found.p90_m, 0.012, 0.006)
    yield _length("line_max", "pose: greatest final deviation", found.max_m, 0.05, 0.025)
    yield _length(
        "line_way", "pose: nine of ten greatest deviations on the way", found.way_p90_m, 0.04, 0.025
    )
    if ("floor", "rough") in groups:
        rough = findings.statistics("line", groups["floor", "rough"])
        yield _length(
            "line_rough", "pose, rough floors: mean of the final deviation", rough.mean_m, 0.012, 0.008
        )
    share = found.no_progress / found.walks
    yield Bar(
        name="line_no_progress",
        asked=f"pose: walks without progress at most {NO_PROGRESS:.0%} (stretch: none)",
        measured=f"{found.no_progress} of {found.walks}, {share:.1%}",
        holds=share <= NO_PROGRESS,
    )
    failed = found.fell + found.others
    yield Bar(
        name="line_falls",
        asked="pose: no walk falls or is stopped",
        measured=f"{found.fell} fell, {found.others} diverged or were stopped",
        holds=failed == 0,
    )
    if "none" in findings.plan.holds:
        yield _at_least("line_over_open", "pose: progress over open loop", found.over_open, 1.0)
    yield _at_least(
        "line_over_ideal", "pose: mean progress over the ideal (stretch: 0.9)", found.over_ideal, 0.75
    )


def _heading_bars(findings: HoldFindings) -> Iterator[Bar]:
    if "heading" in findings.plan.holds:
        _, _, damaged = next(findings.groups())
        found = findings.statistics("heading", damaged)
        yield _length("heading_mean", "yaw: mean of the final deviation", found.mean_m, 0.05, 0.03)
        yield _length("heading_p90", "yaw: nine of ten final deviations", found.p90_m, 0.10, 0.06)


def _intact_bars(findings: HoldFindings) -> Iterator[Bar]:
    """Bars of intact robots in the worlds of real ones."""
    if "line" not in findings.plan.holds or REAL not in findings.plan.families:
        return
    rows = findings.rows("line")
    found = findings.statistics("line", (rows.failures == INTACT) & (rows.families == REAL))
    what = f"pose, intact robots, {REAL} worlds"
    yield _length("intact_mean", f"{what}: mean of the final deviation", found.mean_m, 0.005)
    yield _length("intact_max", f"{what}: greatest final deviation", found.max_m, 0.03)


def _length(name: str, what: str, value_m: float, most_m: float, stretch_m: float | None = None) -> Bar:
    """Bar of a length that is to be at most so long; NaN misses it."""
    stretch = "" if stretch_m is None else f" (stretch: {limit_text(stretch_m)})"
    asked = f"{what} at most {limit_text(most_m)}{stretch}"
    return Bar(name=name, asked=asked, measured=cm(value_m), holds=bool(value_m <= most_m))


def _at_least(name: str, what: str, value: float, least: float) -> Bar:
    asked = f"{what} at least {least:g}"
    return Bar(name=name, asked=asked, measured=f"{value:.3f}", holds=bool(value >= least))
