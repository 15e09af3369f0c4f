"""Holds compared: ends of walks in held-out worlds in open loop, with the yaw, and with the pose."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from operator import itemgetter
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from hexctl.control.trial_plan import AUTO_ROTATION, AskedRotation
from hexctl.options import Typed
from hexctl.palette import REMEDY_COLORS, hex_color
from hexctl.robot.failure_grammar import parse_kind
from hexctl.study.data_frames import where
from hexctl.study.experiment import Drawing, plain
from hexctl.study.figure_style import grid_of, label_axes, new_figure
from hexctl.study.held_out import INTACT
from hexctl.study.held_out_experiment import (
    Columns,
    HeldOutExperiment,
    Record,
    end_statistics,
    groups,
    mean_with_error,
    worlds_text,
)
from hexctl.study.hold_walks import Hold, HoldCase, HoldPlace
from hexctl.study.paper.evidence import (
    Bar,
    clustered_error,
    cm,
    cm_with_error,
    judged_bars,
    limit_text,
    share_text,
    share_with_error,
)
from hexctl.study.plan import check_walkable
from hexctl.study.report_page import Table, markdown
from hexctl.study.walk_cache import ENDED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

#: Earlier worlds of the families were used to develop this comparison.
FIRST_WORLD = 250

#: Default family of worlds.
FAMILY = "transfer"

#: Family of worlds with robots as built, in which intact robots are judged.
REAL = "real"

#: Maximum share of walks without progress.
NO_PROGRESS = 0.03

#: Holds in the words of the report, and their colours.
HOLD_NAMES = {"none": "open loop", "heading": "yaw alone", "line": "pose"}
HOLD_COLORS = dict(zip(HOLD_NAMES, map(hex_color, REMEDY_COLORS), strict=True))

#: Scale of the figures, in cm, and the bins in each factor of ten.
LOW_CM, HIGH_CM, BINS = 0.005, 500.0, 10

#: Height of the highest bin of a histogram in a row of height 1; the text is above.
HEIGHT = 0.7


def statistics(rows: "DataFrame") -> Record:
    """Return the statistics of some walks with one hold; standard errors over worlds, NaN for one world.

    `over_open` is the progress over that of the same walks open loop, both summed.
    """
    over_ideal, over_ideal_error = mean_with_error(rows, "speed")
    over_open, over_open_error = _over_open(rows)
    return {
        "walks": len(rows),
        **end_statistics(rows, 90),
        "over_ideal": over_ideal,
        "over_ideal_error": over_ideal_error,
        "over_open": over_open,
        "over_open_error": over_open_error,
    }


def _over_open(rows: "DataFrame") -> tuple[float, float]:
    """Progress relative to open loop, of walks with both, and its standard error over worlds."""
    known = rows.assign(progress_m=rows["speed"] * rows["ideal_distance_m"])
    known = known[known["progress_m"].notna() & known["open_m"].notna()]
    progress_m, open_m = known["progress_m"].to_numpy(), known["open_m"].to_numpy()
    if not len(known) or open_m.sum() <= 0:
        return float("nan"), float("nan")
    ratio = float(progress_m.sum() / open_m.sum())
    residuals = (progress_m - ratio * open_m) / open_m.mean()
    return ratio, float(clustered_error(residuals, known["place"].to_numpy()))


def _count(name: str) -> Any:
    return lambda one: f"{one[name]} ({share_text(one[name] / one['walks'])})" if one[name] else "0"


COLUMNS: Columns = {
    "": itemgetter("group"),
    "holds": lambda one: HOLD_NAMES[one["hold"]],
    "walks": lambda one: worlds_text(one["walks"], one["worlds"]),
    "final: mean": lambda one: cm_with_error(one["mean_m"], one["mean_error_m"]),
    "90th percentile": lambda one: cm(one["p90_m"]),
    "maximum": lambda one: cm(one["max_m"]),
    "during the walk: 90th percentile": lambda one: cm(one["way_p90_m"]),
    "no progress": _count("no_progress"),
    "fell": _count("fell"),
    "stopped": _count("others"),
    "progress over ideal": lambda one: share_with_error(one["over_ideal"], one["over_ideal_error"]),
    "over open loop": lambda one: share_with_error(one["over_open"], one["over_open_error"]),
}


@dataclass(frozen=True, kw_only=True)
class HoldPlan(HeldOutExperiment):
    """Settings of a comparison of holds.

    Attributes:
        self_rotation: direction of the failed leg during the walk. With `auto`, it points to the rear under
            `heading`, and the robot does not turn under the others, as in `hexctl run --gait auto`. Walks in
            open loop then have the gait of those that hold the line.
    """

    NAME: ClassVar[str] = "holds"
    REPORT: ClassVar[str] = "holds.html"
    TITLE: ClassVar[str] = "hexctl study --hold"
    HEADING: ClassVar[str] = "Open loop, with the yaw, with the pose"

    BY: ClassVar[str] = "hold"
    COLUMNS: ClassVar[Columns] = COLUMNS
    summary = staticmethod(statistics)

    first_world: int = FIRST_WORLD
    failures: Annotated[tuple[str, ...], Typed(flag="failure")] = (
        "locked",
        "limp",
        "missing",
        "weak:0.5",
        "stuck:coxa",
    )
    holds: tuple[Hold, ...] = ("none", "heading", "line")
    self_rotation: AskedRotation = AUTO_ROTATION

    def cases(self) -> list[HoldCase]:
        """Return the cases in each place: intact, then leg by leg."""
        broken = [(0, INTACT), *((leg, failure) for leg in self.legs for failure in self.failures)]
        return [
            HoldCase(leg=leg, failure=failure, hold=hold) for leg, failure in broken for hold in self.holds
        ]

    def walked(self) -> list[tuple[HoldPlace, list[HoldCase]]]:
        """Return the cases to walk, place by place."""
        cases = self.cases()
        return [(HoldPlace(self_rotation=self.self_rotation, **one), cases) for one in self.members()]

    def check(self) -> None:
        """Raise InputError for invalid settings, before anything runs."""
        super().check()
        for failure in self.failures:
            parse_kind(self.legs[0], failure)
        for place, cases in self.walked()[:: len(self.families) * self.worlds]:
            for case in cases:
                check_walkable(f"leg {case.leg} {case.failure}", place.trial(case))

    @staticmethod
    def columns(rows: "DataFrame") -> "DataFrame":
        """Return walks with final deviation and speed, NaN if they did not end on their feet.

        Column `open_m` is the progress of the same walk in open loop, NaN without one.
        """
        ended = rows["status"].isin(ENDED)
        rows = rows.assign(
            final_m=rows["signed_m"].abs().where(ended),
            way_m=rows["max_m"],
            speed=(rows["distance_m"] / rows["ideal_distance_m"]).where(ended),
        )
        same = ["robot", "family", "world", "leg", "failure"]
        open_loop = rows[rows["hold"] == "none"].set_index(same)
        open_m = (open_loop["speed"] * open_loop["ideal_distance_m"]).rename("open_m")
        return rows.join(open_m, on=same)

    @staticmethod
    def divisions(rows: "DataFrame") -> Iterator[tuple[str, str, "DataFrame"]]:
        """Return divisions; all but that by failure leave intact robots out."""
        failed = rows[rows["failure"] != INTACT]
        yield "all", "one leg failed", failed
        yield from groups(rows, {"failure": "failure"})
        floor = failed.assign(floor=np.where(failed["rough"], "rough", "even"))
        columns = {"robot": "robot", "family": "family", "leg": "leg", "kind of world": "kind_of_world"}
        yield from groups(floor, columns | {"floor": "floor"})

    def bars(self, rows: "DataFrame") -> list[Bar]:
        """Return the bars for the walks; walks shorter than the minimum are not judged."""
        line, heading = (where(rows, hold=hold) for hold in ("line", "heading"))
        bars: list[Bar] = []
        if len(line):
            bars += _line_bars(line[line["failure"] != INTACT])
        if len(heading):
            found = statistics(heading[heading["failure"] != INTACT])
            bars.append(
                _length("heading_mean", "yaw: mean of the final deviation", found["mean_m"], 0.05, 0.03)
            )
            what = "yaw: 90th percentile of the final deviation"
            bars.append(_length("heading_p90", what, found["p90_m"], 0.10, 0.06))
        if len(intact := where(line, failure=INTACT, family=REAL)):
            found, what = statistics(intact), f"pose, intact robots, {REAL} worlds"
            bars.append(
                _length("intact_mean", f"{what}: mean of the final deviation", found["mean_m"], 0.005)
            )
            bars.append(_length("intact_max", f"{what}: maximum final deviation", found["max_m"], 0.03))
        return judged_bars(bars, self.duration_s)

    def numbers(self, found: "DataFrame") -> dict[str, Any]:
        """Return settings and results as plain JSON values."""
        return super().numbers(found) | plain(self, "holds", "self_rotation")

    def lines(self, found: "DataFrame") -> list[str]:
        """Return the table of all walks of a failed leg, and the verdicts."""
        failed = [one for one in self.statistics(found) if one["division"] == "all"]
        return [*markdown(Table.of(failed, COLUMNS)), *super().lines(found)]

    def tables(self, found: "DataFrame") -> "Mapping[str, DataFrame]":
        """Return the table of all walks."""
        shown = found.drop(columns=["speed", "open_m", "way_m", "place"])
        return {"holds": shown.rename(columns={"kind_of_world": "kind"})}

    def drawings(self, found: "DataFrame") -> Sequence[Drawing]:
        """Return the figures of the report."""
        here = (
            "Heights are numbers of walks. Lines are means, dots 90th percentiles. The scale is logarithmic."
        )
        failed = found[found["failure"] != INTACT]
        title = self.figure_title(failed, ", one leg failed")
        everything, each = [("", failed)], [(name, some) for _, name, some in groups(found, {"": "failure"})]
        return (
            Drawing(name="holds", draw=partial(_figure, self.holds, everything, title), here=here),
            Drawing(
                name="holds_by_failure", draw=partial(_figure, self.holds, each, "By failure"), here=here
            ),
        )

    def remarks(self, found: "DataFrame") -> list[str]:
        """Return the self-rotation in words."""
        return [f"Self-rotation: {self.self_rotation}."]


def _line_bars(rows: "DataFrame") -> Iterator[Bar]:
    found = statistics(rows)
    final = "of the final deviation"
    yield _length("line_mean", f"pose: mean {final}", found["mean_m"], 0.006, 0.003)
    yield _length("line_p90", f"pose: 90th percentile {final}", found["p90_m"], 0.012, 0.006)
    yield _length("line_max", "pose: maximum final deviation", found["max_m"], 0.05, 0.025)
    what = "pose: 90th percentile of the maximum deviation during a walk"
    yield _length("line_way", what, found["way_p90_m"], 0.04, 0.025)
    if rows["rough"].any():
        rough = statistics(rows[rows["rough"]])
        yield _length("line_rough", f"pose, rough floors: mean {final}", rough["mean_m"], 0.012, 0.008)
    share = found["no_progress"] / found["walks"]
    yield Bar(
        name="line_no_progress",
        asked=f"pose: walks without progress at most {NO_PROGRESS:.0%} (stretch: none)",
        measured=f"{found['no_progress']} of {found['walks']}, {share:.1%}",
        holds=share <= NO_PROGRESS,
    )
    yield Bar(
        name="line_falls",
        asked="pose: no walk falls or is stopped",
        measured=f"{found['fell']} fell, {found['others']} diverged or were stopped",
        holds=found["fell"] + found["others"] == 0,
    )
    if rows["open_m"].notna().any():
        yield _at_least("line_over_open", "pose: progress over open loop", found["over_open"], 1.0)
    what = "pose: mean progress over the ideal (stretch: 0.9)"
    yield _at_least("line_over_ideal", what, found["over_ideal"], 0.75)


def _length(name: str, what: str, value_m: float, most_m: float, stretch_m: float | None = None) -> Bar:
    """Bar with an upper limit; NaN misses it."""
    stretch = "" if stretch_m is None else f" (stretch: {limit_text(stretch_m)})"
    asked = f"{what} at most {limit_text(most_m)}{stretch}"
    return Bar(name=name, asked=asked, measured=cm(value_m), holds=bool(value_m <= most_m))


def _at_least(name: str, what: str, value: float, least: float) -> Bar:
    asked = f"{what} at least {least:g}"
    return Bar(name=name, asked=asked, measured=f"{value:.3f}", holds=bool(value >= least))


def _figure(holds: Sequence[str], each: Sequence[tuple[str, "DataFrame"]], title: str) -> "Figure":
    """Draw distributions of the final deviation: a panel for each group of walks, a row for each hold."""
    across, columns = grid_of(len(each))
    wide, high = (9.0, 0.9 + 1.1 * len(holds)) if len(each) == 1 else (5.2, 0.7 + 0.8 * len(holds))
    figure, panels = new_figure(across, columns, (wide * columns, high * across))
    for panel, (name, rows) in zip(panels, each, strict=False):
        for row, hold in enumerate(holds):
            _distribution(panel, where(rows, hold=hold), -float(row), HOLD_COLORS[hold])
        panel.set_title(name, fontsize=9)
        panel.set_ylim(1 - len(holds), 1)
        panel.set_yticks([0.3 - row for row in range(len(holds))], [HOLD_NAMES[hold] for hold in holds])
        panel.tick_params(axis="y", length=0)
        panel.set_xscale("log")
        panel.set_xlim(LOW_CM, HIGH_CM)
        ticks = [0.01, 0.1, 1.0, 10.0, 100.0]
        panel.set_xticks(ticks, [f"{tick:g} cm" for tick in ticks])
    label_axes(
        panels, len(each), "deviation from the line at the end (line: mean; dots: 90th percentile)", ""
    )
    for panel in panels:
        panel.grid(visible=False, axis="y")
    figure.suptitle(title, fontsize=11)
    return figure


def _distribution(panel: "Axes", rows: "DataFrame", base: float, color: str) -> None:
    """Draw a histogram above a base line, with mean, 90th percentile and maximum."""
    found = statistics(rows)
    edges = np.geomspace(LOW_CM, HIGH_CM, round(BINS * np.log10(HIGH_CM / LOW_CM)) + 1)
    counts, _ = np.histogram(np.clip(100 * rows["final_m"].dropna(), LOW_CM, HIGH_CM), edges)
    heights = base + HEIGHT * counts / max(1, counts.max())
    panel.stairs(heights, edges, baseline=base, fill=True, color=color, alpha=0.85)
    panel.axhline(base, color="#222222", linewidth=0.6)
    for name, style in (("mean_m", "-"), ("p90_m", ":")):
        at_cm = [100 * found[name]] * 2
        panel.plot(at_cm, [base, base + HEIGHT], style, color="#222222", linewidth=1.3)
    ends = [cm(found[name]) for name in ("mean_m", "p90_m", "max_m")]
    text = "mean {}, 90th percentile {}, maximum {}".format(*ends)
    panel.text(LOW_CM * 1.15, base + HEIGHT + 0.06, text, fontsize=8)
