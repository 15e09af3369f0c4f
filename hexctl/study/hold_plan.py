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
from hexctl.study.experiment import Drawing, plain, where
from hexctl.study.figure_style import new_figure
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
from hexctl.study.paper.evidence import cm, cm_with_error, share_text, share_with_error
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

#: Holds in the words of the report, and their colours.
HOLD_NAMES = {"none": "open loop", "heading": "yaw alone", "line": "pose"}
HOLD_COLORS = dict(zip(HOLD_NAMES, map(hex_color, REMEDY_COLORS), strict=True))

#: Scale of the figures, in cm, and the bins in each factor of ten.
LOW_CM, HIGH_CM, BINS = 0.005, 500.0, 10

#: Height of the highest bin of a histogram in a row of height 1; the text is above.
HEIGHT = 0.7


def statistics(rows: "DataFrame") -> Record:
    """Return the statistics of some walks with one hold; standard errors over worlds, NaN for one world."""
    over_ideal, over_ideal_error = mean_with_error(rows, "speed")
    return {
        "walks": len(rows),
        **end_statistics(rows, 90),
        "over_ideal": over_ideal,
        "over_ideal_error": over_ideal_error,
    }


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
        """Return walks with final deviation and speed, NaN if they did not end on their feet."""
        ended = rows["status"].isin(ENDED)
        return rows.assign(
            final_m=rows["signed_m"].abs().where(ended),
            way_m=rows["max_m"],
            speed=(rows["distance_m"] / rows["ideal_distance_m"]).where(ended),
        )

    @staticmethod
    def divisions(rows: "DataFrame") -> Iterator[tuple[str, str, "DataFrame"]]:
        """Return divisions; all but that by failure leave intact robots out."""
        failed = rows[rows["failure"] != INTACT]
        yield "all", "one leg failed", failed
        yield from groups(rows, {"failure": "failure"})
        floor = failed.assign(floor=np.where(failed["rough"], "rough", "even"))
        columns = {"robot": "robot", "family": "family", "leg": "leg", "kind of world": "kind_of_world"}
        yield from groups(floor, columns | {"floor": "floor"})

    def numbers(self, found: "DataFrame") -> dict[str, Any]:
        """Return settings and results as plain JSON values."""
        return super().numbers(found) | plain(self, "holds", "self_rotation")

    def lines(self, found: "DataFrame") -> list[str]:
        """Return the table of all walks of a failed leg."""
        failed = [one for one in self.statistics(found) if one["division"] == "all"]
        return markdown(Table.of(failed, COLUMNS))

    def tables(self, found: "DataFrame") -> "Mapping[str, DataFrame]":
        """Return the table of all walks."""
        shown = found.drop(columns=["speed", "way_m", "place"])
        return {"holds": shown.rename(columns={"kind_of_world": "kind"})}

    def drawings(self, found: "DataFrame") -> Sequence[Drawing]:
        """Return the figure of the report."""
        here = (
            "Heights are numbers of walks. Lines are means, dots 90th percentiles. The scale is logarithmic."
        )
        failed = found[found["failure"] != INTACT]
        title = self.figure_title(failed, ", one leg failed")
        return (Drawing(name="holds", draw=partial(_figure, self.holds, failed, title), here=here),)

    def remarks(self, found: "DataFrame") -> list[str]:
        """Return the self-rotation in words."""
        return [f"Self-rotation: {self.self_rotation}."]


def _figure(holds: Sequence[str], rows: "DataFrame", title: str) -> "Figure":
    """Draw distributions of the final deviation, a row for each hold."""
    figure, (panel,) = new_figure(1, 1, (9.0, 0.9 + 1.1 * len(holds)))
    for row, hold in enumerate(holds):
        _distribution(panel, where(rows, hold=hold), -float(row), HOLD_COLORS[hold])
    panel.set_ylim(1 - len(holds), 1)
    panel.set_yticks([0.3 - row for row in range(len(holds))], [HOLD_NAMES[hold] for hold in holds])
    panel.tick_params(axis="y", length=0)
    panel.set_xscale("log")
    panel.set_xlim(LOW_CM, HIGH_CM)
    ticks = [0.01, 0.1, 1.0, 10.0, 100.0]
    panel.set_xticks(ticks, [f"{tick:g} cm" for tick in ticks])
    panel.set_xlabel("deviation from the line at the end (line: mean; dots: 90th percentile)", fontsize=9)
    panel.grid(visible=True, axis="x", linewidth=0.3)
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
