"""The report of a comparison of holds: one HTML page, with figures and a table of all walks beside it."""

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hexctl.files import atomic_write
from hexctl.palette import REMEDY_COLORS, hex_color
from hexctl.study.holds.hold_conditions import SENSORS
from hexctl.study.holds.hold_findings import HoldFindings, HoldStatistics, hold_bars
from hexctl.study.landscapes.versions import code_versions
from hexctl.study.reports.figure_style import grid_of, label_axes, new_figure, save_figure
from hexctl.study.reports.report_page import Bullets, Picture, Section, Table, render_page
from hexctl.study.reports.study_tables import number
from hexctl.study.verdicts.claim_evidence import cm, share_text
from hexctl.types import BoolArray, FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

REPORT = "holds.html"
TABLE = "holds.parquet"
FIGURES = ("holds", "holds_by_failure")

#: What is held, in the words of the report.
HOLD_NAMES = {"none": "open loop", "heading": "yaw alone", "line": "pose"}

#: Colours of what is held.
HOLD_COLORS = dict(zip(("none", "heading", "line"), map(hex_color, REMEDY_COLORS), strict=True))

#: The scale of the figures, in cm, and the bins in each factor of ten.
LOW_CM, HIGH_CM, BINS = 0.005, 500.0, 10

#: Height of the highest bin of a histogram, where a row is 1 high; the text is above.
HEIGHT = 0.7

READING = (
    "Deviations are those of the simulation's true pose from the line, whatever the sensors told the robot.",
    "No walk had a trial: the gait is that of --gait auto, with the largest static stability margin for the "
    "failed leg, the body raised off a locked one that does not trail.",
    "Walks without progress (less than half of the ideal distance) count in the deviations and in the "
    "speed. Walks that fell, diverged or were stopped have no deviation and are counted apart.",
    "Progress over open loop: the sum over walks over the sum of the same walks open loop, along the line.",
    "± is the standard error over worlds: walks in one world are not independent.",
    "Nine of ten: the 90th percentile. The bars are judged by the numbers themselves, not by intervals.",
)

HEADER = (
    "",
    "holds",
    "walks",
    "final: mean",
    "nine of ten",
    "greatest",
    "on the way: nine of ten",
    "no progress",
    "fell",
    "stopped",
    "progress over ideal",
    "over open loop",
)


def holds_figure(findings: HoldFindings) -> "Figure":
    """Distributions of the final deviation of all robots with a failed leg, a row for each hold."""
    figure, panels = new_figure(1, 1, (9.0, 0.9 + 1.1 * len(findings.plan.holds)))
    _, _, damaged = next(findings.groups())
    _draw(panels[0], findings, damaged)
    worlds = findings.statistics(findings.plan.holds[0], damaged).worlds
    robots = ", ".join(robot.name for robot in findings.plan.robots)
    title = f"{robots}, one leg failed, {worlds} unseen worlds, {findings.plan.duration_s:g} s, no trial"
    _finish(figure, panels, 1, title)
    return figure


def failures_figure(findings: HoldFindings) -> "Figure":
    """The same for each failure, and for intact robots."""
    groups = [(name, which) for division, name, which in findings.groups() if division == "failure"]
    rows, columns = grid_of(len(groups))
    figure, panels = new_figure(rows, columns, (5.2 * columns, (0.7 + 0.8 * len(findings.plan.holds)) * rows))
    for panel, (name, which) in zip(panels, groups, strict=False):
        _draw(panel, findings, which)
        panel.set_title(name, fontsize=9)
    _finish(figure, panels, len(groups), "By failure")
    return figure


def _draw(panel: "Axes", findings: HoldFindings, which: BoolArray) -> None:
    """Draw a histogram for each hold, one above the other, with mean, 90th percentile and maximum."""
    edges = np.geomspace(LOW_CM, HIGH_CM, round(BINS * np.log10(HIGH_CM / LOW_CM)) + 1)
    names = []
    for row, hold in enumerate(findings.plan.holds):
        final_cm = 100 * findings.rows(hold).final_m[which]
        final_cm = np.clip(final_cm[np.isfinite(final_cm)], LOW_CM, HIGH_CM)
        found = findings.statistics(hold, which)
        base = -float(row)
        _histogram(panel, final_cm, edges, base, HOLD_COLORS[hold])
        for value_m, style in ((found.mean_m, "-"), (found.p90_m, ":")):
            panel.plot([100 * value_m] * 2, [base, base + HEIGHT], style, color="#222222", linewidth=1.3)
        said = f"mean {cm(found.mean_m)}, nine of ten below {cm(found.p90_m)}, greatest {cm(found.max_m)}"
        panel.text(LOW_CM * 1.15, base + HEIGHT + 0.06, said, fontsize=8)
        names.append(HOLD_NAMES[hold])
    panel.set_ylim(1 - len(names), 1)
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


def write_hold_report(findings: HoldFindings, folder: Path) -> Path:
    """Write table, figures and the report into a folder; path of the report."""
    _write_table(findings, folder)
    for name, draw in zip(FIGURES, (holds_figure, failures_figure), strict=True):
        save_figure(draw(findings), folder, name)
    sections = [*_head(findings), *_pictures(folder), *_tables(findings)]
    heading = "Open loop, with the yaw, with the pose"
    atomic_write(folder / REPORT, render_page("hexctl study --hold", heading, sections))
    return folder / REPORT


def holds_json(findings: HoldFindings) -> dict[str, Any]:
    """Settings and results of a comparison as JSON values; null where there is no number."""
    plan = findings.plan
    return {
        "robots": [robot.name for robot in plan.robots],
        "families": list(plan.families),
        "first_world": plan.first_world,
        "worlds": plan.worlds,
        "legs": list(plan.legs),
        "failures": list(plan.failures),
        "holds": list(plan.holds),
        "self_rotation": plan.self_rotation,
        "duration_s": plan.duration_s,
        "sensors": None if plan.exact_sensors else SENSORS,
        "code": code_versions(),
        "walks": len(findings.walks),
        "bars": [bar.as_json() for bar in hold_bars(findings)],
        "statistics": [
            {"division": division, "group": name, "hold": hold} | _numbers(findings.statistics(hold, which))
            for division, name, which in findings.groups()
            for hold in plan.holds
        ],
    }


def _numbers(found: HoldStatistics) -> dict[str, Any]:
    values = asdict(found)
    return {name: number(value) if isinstance(value, float) else value for name, value in values.items()}


def holds_lines(findings: HoldFindings) -> list[str]:
    """Table of all walks with a failed leg, as lines of Markdown."""
    (_, name, which), *_ = findings.groups()
    lines = ["| " + " | ".join(HEADER) + " |", "|---" * len(HEADER) + "|"]
    rows = [_row(name, hold, findings.statistics(hold, which)) for hold in findings.plan.holds]
    return [*lines, *("| " + " | ".join(row) + " |" for row in rows)]


def _head(findings: HoldFindings) -> Iterator[Section]:
    plan = findings.plan
    numbers = f"{plan.first_world} to {plan.first_world + plan.worlds - 1}"
    sensors = (
        "Sensors as the worlds have them."
        if plan.exact_sensors
        else "Sensors 40 ms late, with 1 cm and 0.5 degrees of noise; 5 % of the poses are lost."
    )
    settings = (
        f"{', '.join(robot.name for robot in plan.robots)}; worlds {numbers} of "
        f"{' and '.join(plan.families)}; legs {', '.join(map(str, plan.legs))}, each "
        f"{', '.join(plan.failures)}, and intact robots; self-rotation {plan.self_rotation}; "
        f"{plan.duration_s:g} s a walk; {len(findings.walks)} walks. {sensors}"
    )
    yield Section("", [settings])
    rows = [(bar.asked, bar.measured, bar.verdict) for bar in hold_bars(findings)]
    yield Section("Bars", [Table(("asked", "measured", "verdict"), rows)])
    yield Section("How to read this", [Bullets(READING)])


def _pictures(folder: Path) -> Iterator[Section]:
    here = (
        "Heights are numbers of walks. The line is the mean, the dots nine of ten. The scale is logarithmic."
    )
    pictures = [Picture(folder / f"{name}.svg", "Not in the paper.", here) for name in FIGURES]
    yield Section("Where walks end", pictures)


def _tables(findings: HoldFindings) -> Iterator[Section]:
    """A table for each division of the walks."""
    rows: dict[str, list[tuple[str, ...]]] = {}
    for division, name, which in findings.groups():
        some = [_row(name, hold, findings.statistics(hold, which)) for hold in findings.plan.holds]
        rows.setdefault(division, []).extend(some)
    for division, lines in rows.items():
        title = "All" if division == "all" else f"By {division}"
        yield Section(title, [Table(HEADER, lines)])
    yield Section("Versions", [", ".join(f"{name} {value}" for name, value in code_versions().items())])


def _row(name: str, hold: str, found: HoldStatistics) -> tuple[str, ...]:
    return (
        name,
        HOLD_NAMES[hold],
        f"{found.walks} in {found.worlds} world{'s' * (found.worlds != 1)}",
        cm(found.mean_m) + (f" ± {cm(found.mean_error_m)}" if np.isfinite(found.mean_error_m) else ""),
        cm(found.p90_m),
        cm(found.max_m),
        cm(found.way_p90_m),
        _count(found.no_progress, found.walks),
        _count(found.fell, found.walks),
        _count(found.others, found.walks),
        _with_error(found.over_ideal, found.over_ideal_error),
        _with_error(found.over_open, found.over_open_error),
    )


def _count(count: int, walks: int) -> str:
    return f"{count} ({share_text(count / walks)})" if count else "0"


def _with_error(value: float, error: float) -> str:
    if not np.isfinite(value):
        return "-"
    return f"{value:.2f}" + (f" ± {error:.2f}" if np.isfinite(error) else "")


def _write_table(findings: HoldFindings, folder: Path) -> None:
    """Write a row for each walk."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = []
    for place, walk in findings.walks:
        values = asdict(walk)
        case = values.pop("case")
        where = {
            "robot": place.robot.name,
            "family": place.family,
            "world": place.number,
            "kind": place.kind,
            "rough": place.rough,
        }
        rows.append(where | case | values | {"slots": list(walk.slots), "final_m": walk.final_m})
    pq.write_table(pa.Table.from_pylist(rows), folder / TABLE)
