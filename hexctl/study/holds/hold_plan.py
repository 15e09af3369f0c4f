"""Holds compared: where walks in held-out worlds end open loop, with the yaw, and with the pose."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from hexctl.control.trial_plan import AUTO_ROTATION, AskedRotation
from hexctl.options import Typed
from hexctl.palette import REMEDY_COLORS, hex_color
from hexctl.robot.failure_grammar import parse_kind
from hexctl.study.evidence import (
    Bar,
    clustered_error,
    cm,
    cm_with_error,
    judged_bars,
    limit_text,
    share_text,
    share_with_error,
)
from hexctl.study.experiment import Drawing, plain
from hexctl.study.figure_style import grid_of, label_axes, new_figure
from hexctl.study.held_out import INTACT
from hexctl.study.held_out_experiment import (
    Columns,
    HeldOutExperiment,
    Record,
    groups,
    mean,
    percentile,
    table_of,
    world_names,
    worlds_text,
)
from hexctl.study.holds.hold_walks import Hold, HoldCase, HoldPlace
from hexctl.study.plan import check_walkable
from hexctl.study.report_page import markdown
from hexctl.study.walk_cache import ENDED
from hexctl.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

#: Earlier members of the families were used while this comparison was built.
FIRST_WORLD = 250

#: Default family of worlds.
FAMILY = "transfer"


#: The family of worlds with robots as they are built, in which intact robots are judged.
REAL = "real"

#: Share of walks that may make no progress.
NO_PROGRESS = 0.03

#: Holds in the words of the report, and their colours.
HOLD_NAMES = {"none": "open loop", "heading": "yaw alone", "line": "pose"}
HOLD_COLORS = dict(zip(HOLD_NAMES, map(hex_color, REMEDY_COLORS), strict=True))

#: Scale of the figures, in cm, and the bins in each factor of ten.
LOW_CM, HIGH_CM, BINS = 0.005, 500.0, 10

#: Height of the highest bin of a histogram in a row of height 1; the text is above.
HEIGHT = 0.7


def with_ends(rows: "DataFrame") -> "DataFrame":
    """Return walks with their final deviation and speed, NaN if they did not end on their feet.

    Column `open_m` is the progress of the same walk in open loop, NaN if that was not walked.
    """
    ended = rows["status"].isin(ENDED)
    rows = rows.assign(
        final_m=rows["signed_m"].abs().where(ended),
        speed=(rows["distance_m"] / rows["ideal_distance_m"]).where(ended),
    )
    same = ["robot", "family", "world", "leg", "failure"]
    open_loop = rows[rows["hold"] == "none"].set_index(same)
    open_m = (open_loop["speed"] * open_loop["ideal_distance_m"]).rename("open_m")
    return rows.join(open_m, on=same)


def divisions(rows: "DataFrame") -> Iterator[tuple[str, str, "DataFrame"]]:
    """Return name of a division, name of a group in it, and its walks.

    All divisions but that by failure leave intact robots out.
    """
    failed = rows[rows["failure"] != INTACT]
    yield "all", "one leg failed", failed
    yield from groups(rows, {"failure": "failure"})
    floor = failed.assign(floor=np.where(failed["rough"], "rough", "even"))
    columns = {"robot": "robot", "family": "family", "leg": "leg", "kind of world": "kind_of_world"}
    yield from groups(floor, columns | {"floor": "floor"})


def statistics(rows: "DataFrame") -> Record:
    """Return the statistics of some walks with one hold; standard errors over worlds, NaN for one world.

    Walks that fell, diverged or were stopped have no deviation; those without progress have. `over_open` is
    the progress over that of the same walks open loop, both summed.
    """
    worlds = world_names(rows).to_numpy()
    final_m, speed = rows["final_m"].to_numpy(), rows["speed"].to_numpy()
    ended = np.isfinite(final_m)
    progress_m, open_m = speed * rows["ideal_distance_m"].to_numpy(), rows["open_m"].to_numpy()
    over_open, over_open_error = _ratio(progress_m, open_m, worlds)
    fell = int((rows["status"] == "fell").sum())
    return {
        "walks": len(rows),
        "worlds": len(np.unique(worlds)),
        "mean_m": mean(final_m[ended]),
        "mean_error_m": float(clustered_error(final_m[ended], worlds[ended])),
        "p90_m": percentile(final_m[ended], 90),
        "max_m": percentile(final_m[ended], 100),
        "way_p90_m": percentile(rows["max_m"].to_numpy()[ended], 90),
        "no_progress": int((rows["status"] == "no_progress").sum()),
        "fell": fell,
        "others": len(rows) - int(ended.sum()) - fell,
        "over_ideal": mean(speed[ended]),
        "over_ideal_error": float(clustered_error(speed[ended], worlds[ended])),
        "over_open": over_open,
        "over_open_error": over_open_error,
    }


def _ratio(above: FloatArray, below: FloatArray, worlds: Any) -> tuple[float, float]:
    """Sum of some values over that of others, pairs with NaN left out, and its standard error over worlds."""
    known = np.isfinite(above) & np.isfinite(below)
    above, below, worlds = above[known], below[known], worlds[known]
    if not known.any() or below.sum() <= 0:
        return float("nan"), float("nan")
    ratio = float(above.sum() / below.sum())
    return ratio, float(clustered_error((above - ratio * below) / below.mean(), worlds))


def _count(name: str) -> Any:
    """Text of a number of walks and their share."""
    return lambda one: f"{one[name]} ({share_text(one[name] / one['walks'])})" if one[name] else "0"


COLUMNS: Columns = {
    "holds": lambda one: HOLD_NAMES[one["hold"]],
    "walks": lambda one: worlds_text(one["walks"], one["worlds"]),
    "final: mean": lambda one: cm_with_error(one["mean_m"], one["mean_error_m"]),
    "nine of ten": lambda one: cm(one["p90_m"]),
    "greatest": lambda one: cm(one["max_m"]),
    "on the way: nine of ten": lambda one: cm(one["way_p90_m"]),
    "no progress": _count("no_progress"),
    "fell": _count("fell"),
    "stopped": _count("others"),
    "progress over ideal": lambda one: share_with_error(one["over_ideal"], one["over_ideal_error"]),
    "over open loop": lambda one: share_with_error(one["over_open"], one["over_open_error"]),
}


def hold_bars(rows: "DataFrame", duration_s: float) -> list[Bar]:
    """Return the bars that walks reach; none is judged on walks that are too short."""
    line, heading = (rows[rows["hold"] == hold] for hold in ("line", "heading"))
    bars: list[Bar] = []
    if len(line):
        bars += _line_bars(line[line["failure"] != INTACT])
    if len(heading):
        found = statistics(heading[heading["failure"] != INTACT])
        bars.append(_length("heading_mean", "yaw: mean of the final deviation", found["mean_m"], 0.05, 0.03))
        bars.append(_length("heading_p90", "yaw: nine of ten final deviations", found["p90_m"], 0.10, 0.06))
    if len(intact := line[(line["failure"] == INTACT) & (line["family"] == REAL)]):
        found, what = statistics(intact), f"pose, intact robots, {REAL} worlds"
        bars.append(_length("intact_mean", f"{what}: mean of the final deviation", found["mean_m"], 0.005))
        bars.append(_length("intact_max", f"{what}: greatest final deviation", found["max_m"], 0.03))
    return judged_bars(bars, duration_s)


def _line_bars(rows: "DataFrame") -> Iterator[Bar]:
    """Bars of walks of a failed leg that hold their line."""
    found = statistics(rows)
    final = "of the final deviation"
    yield _length("line_mean", f"pose: mean {final}", found["mean_m"], 0.006, 0.003)
    yield _length("line_p90", "pose: nine of ten final deviations", found["p90_m"], 0.012, 0.006)
    yield _length("line_max", "pose: greatest final deviation", found["max_m"], 0.05, 0.025)
    what = "pose: nine of ten greatest deviations on the way"
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
    """Bar of a length that is to be at most so long; NaN misses it."""
    stretch = "" if stretch_m is None else f" (stretch: {limit_text(stretch_m)})"
    asked = f"{what} at most {limit_text(most_m)}{stretch}"
    return Bar(name=name, asked=asked, measured=cm(value_m), holds=bool(value_m <= most_m))


def _at_least(name: str, what: str, value: float, least: float) -> Bar:
    return Bar(
        name=name, asked=f"{what} at least {least:g}", measured=f"{value:.3f}", holds=bool(value >= least)
    )


@dataclass(frozen=True, kw_only=True)
class HoldPlan(HeldOutExperiment):
    """Settings of a comparison of holds.

    Attributes:
        self_rotation: direction of the failed leg during the walk. With `auto`, it points to the rear under
            the hold `heading` and stays as it is under the others, as `hexctl run --gait auto` does. Walks
            in open loop then have the gait of those that hold the line.
    """

    NAME: ClassVar[str] = "holds"
    REPORT: ClassVar[str] = "holds.html"
    TITLE: ClassVar[str] = "hexctl study --hold"
    HEADING: ClassVar[str] = "Open loop, with the yaw, with the pose"

    BY: ClassVar[str] = "hold"
    COLUMNS: ClassVar[Columns] = COLUMNS
    columns = staticmethod(with_ends)
    divisions = staticmethod(divisions)
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

    def places(self) -> list[HoldPlace]:
        """Return each robot in each world."""
        return [HoldPlace(self_rotation=self.self_rotation, **one) for one in self.members()]

    def cases(self) -> list[HoldCase]:
        """Return the cases in each place: intact, then leg by leg."""
        broken = [(0, INTACT), *((leg, failure) for leg in self.legs for failure in self.failures)]
        return [
            HoldCase(leg=leg, failure=failure, hold=hold) for leg, failure in broken for hold in self.holds
        ]

    def walked(self) -> list[tuple[HoldPlace, list[HoldCase]]]:
        """Return the cases to walk, place by place."""
        cases = self.cases()
        return [(place, cases) for place in self.places()]

    def check(self) -> None:
        """Raise InputError for settings that are not allowed, before anything runs."""
        super().check()
        for failure in self.failures:
            parse_kind(self.legs[0], failure)
        for place in self.places()[:: len(self.families) * self.worlds]:
            for case in self.cases():
                check_walkable(f"leg {case.leg} {case.failure}", place.trial(case))

    def bars(self, rows: "DataFrame") -> list[Bar]:
        """Return the bars that the walks are to reach."""
        return hold_bars(rows, self.duration_s)

    def numbers(self, found: "DataFrame") -> dict[str, Any]:
        """Return settings and results as plain JSON values."""
        return super().numbers(found) | plain(self, "holds", "self_rotation")

    def lines(self, found: "DataFrame") -> list[str]:
        """Return the table of all walks of a failed leg, and the verdicts."""
        failed = [one for one in self.statistics(found) if one["division"] == "all"]
        return [*markdown(table_of(failed, COLUMNS)), *super().lines(found)]

    def tables(self, found: "DataFrame") -> "Mapping[str, DataFrame]":
        """Return the table of all walks."""
        return {"holds": found.rename(columns={"kind_of_world": "kind"}).drop(columns=["speed", "open_m"])}

    def drawings(self, found: "DataFrame") -> Sequence[Drawing]:
        """Return the figures of the report."""
        here = (
            "Heights are numbers of walks. Lines are means, dots 90th percentiles. The scale is logarithmic."
        )
        return (
            Drawing(name="holds", draw=partial(holds_figure, self, found), here=here),
            Drawing(name="holds_by_failure", draw=partial(failures_figure, self, found), here=here),
        )

    def remarks(self, found: "DataFrame") -> list[str]:
        """Return the self-rotation in words."""
        return [f"Self-rotation: {self.self_rotation}."]


def holds_figure(plan: HoldPlan, rows: "DataFrame") -> "Figure":
    """Draw the distributions of the final deviation of robots with a failed leg, a row for each hold."""
    figure, panels = new_figure(1, 1, (9.0, 0.9 + 1.1 * len(plan.holds)))
    failed = rows[rows["failure"] != INTACT]
    _draw(panels[0], plan, failed)
    robots, worlds = ", ".join(robot.name for robot in plan.robots), world_names(failed).nunique()
    title = f"{robots}, one leg failed, {worlds} unseen worlds, {plan.duration_s:g} s, no trial"
    _finish(figure, panels, 1, title)
    return figure


def failures_figure(plan: HoldPlan, rows: "DataFrame") -> "Figure":
    """Draw the same for each failure, and for intact robots."""
    each = list(groups(rows, {"failure": "failure"}))
    across, columns = grid_of(len(each))
    figure, panels = new_figure(across, columns, (5.2 * columns, (0.7 + 0.8 * len(plan.holds)) * across))
    for panel, (_, name, some) in zip(panels, each, strict=False):
        _draw(panel, plan, some)
        panel.set_title(name, fontsize=9)
    _finish(figure, panels, len(each), "By failure")
    return figure


def _draw(panel: "Axes", plan: HoldPlan, rows: "DataFrame") -> None:
    """Draw a histogram for each hold, one above the other, with mean, 90th percentile and maximum."""
    edges = np.geomspace(LOW_CM, HIGH_CM, round(BINS * np.log10(HIGH_CM / LOW_CM)) + 1)
    for row, hold in enumerate(plan.holds):
        some = rows[rows["hold"] == hold]
        found, base = statistics(some), -float(row)
        final_cm = np.clip(100 * some["final_m"].dropna().to_numpy(), LOW_CM, HIGH_CM)
        _histogram(panel, final_cm, edges, base, HOLD_COLORS[hold])
        for name, style in (("mean_m", "-"), ("p90_m", ":")):
            at_cm = [100 * found[name]] * 2
            panel.plot(at_cm, [base, base + HEIGHT], style, color="#222222", linewidth=1.3)
        ends = [cm(found[name]) for name in ("mean_m", "p90_m", "max_m")]
        said = "mean {}, nine of ten below {}, greatest {}".format(*ends)
        panel.text(LOW_CM * 1.15, base + HEIGHT + 0.06, said, fontsize=8)
    panel.set_ylim(1 - len(plan.holds), 1)
    names = [HOLD_NAMES[hold] for hold in plan.holds]
    panel.set_yticks([0.3 - row for row in range(len(names))], names)
    panel.tick_params(axis="y", length=0)


def _histogram(panel: "Axes", values_cm: FloatArray, edges_cm: FloatArray, base: float, color: str) -> None:
    counts, _ = np.histogram(values_cm, edges_cm)
    heights = base + HEIGHT * counts / max(1, counts.max())
    panel.stairs(heights, edges_cm, baseline=base, fill=True, color=color, alpha=0.85)
    panel.axhline(base, color="#222222", linewidth=0.6)


def _finish(figure: "Figure", panels: "list[Axes]", used: int, title: str) -> None:
    for panel in panels[:used]:
        panel.set_xscale("log")
        panel.set_xlim(LOW_CM, HIGH_CM)
        ticks = [0.01, 0.1, 1.0, 10.0, 100.0]
        panel.set_xticks(ticks, [f"{tick:g} cm" for tick in ticks])
    label_axes(panels, used, "deviation from the line at the end (line: mean; dots: nine of ten below)", "")
    for panel in panels:
        panel.grid(visible=False, axis="y")
    figure.suptitle(title, fontsize=11)
