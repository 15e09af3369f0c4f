"""The report of the recovery benchmark: one HTML page, with a figure and a table of all walks beside it."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hexctl.files import atomic_write
from hexctl.palette import OTHER_REMEDY_COLORS, REMEDY_COLORS, hex_color
from hexctl.study.holds.hold_conditions import SENSORS
from hexctl.study.landscapes.versions import code_versions
from hexctl.study.recovery.episodes import Episode
from hexctl.study.recovery.methods import method_of
from hexctl.study.recovery.recovery_criteria import recovery_bars
from hexctl.study.recovery.recovery_findings import (
    Judged,
    RecoveryFindings,
    RecoveryStatistics,
    counted,
)
from hexctl.study.recovery.recovery_plan import HEXAHEAL, LINE, RULED, SECOND
from hexctl.study.reports.figure_style import save_figure
from hexctl.study.reports.report_page import Bullets, Picture, Section, Table, render_page
from hexctl.study.reports.study_tables import number
from hexctl.study.verdicts.claim_evidence import cm
from hexctl.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

REPORT = "recovery.html"
TABLE = "recovery.parquet"
FIGURE = "recovery"

#: Colours of the methods, and of any other one.
METHOD_COLORS = dict(zip(("nothing", "told", "recover"), map(hex_color, REMEDY_COLORS), strict=True))
OTHER_COLORS = tuple(map(hex_color, OTHER_REMEDY_COLORS))

#: Lower end of the scale of deviations, in cm.
LOW_CM = 0.01

READING = (
    "nothing walks on; told is an oracle that is told leg and kind in the tick of the failure; recover "
    "notices by itself. Both glide to the same gaits.",
    "stop-diagnose stops at an alarm, makes the standing test, and begins anew on its line with the gait for "
    "what the test has found; its alarms are these findings. decentralised steps each leg by its own load "
    "and its neighbours'. open-loop-best is told which leg it is and walks on in open loop, with the gait "
    "that ended nearest its line in trials of that failure in that world, which are counted apart.",
    "Deviations are those of the simulation's true pose from the line that the walk began on.",
    "Right leg: the first alarm of the walk, after the failure, is of that leg. Right kind: the joint and "
    "the kind too, among failures that matter: with nothing done they change the end by more than 2 cm, or "
    "the speed by more than 10 %, against the intact walk in the same world and direction, or the robot "
    "falls.",
    "Speed kept: from 5 s after the failure on, over that of the intact walk. The worst cell is the mean "
    "over worlds of one robot, gait, leg and failure.",
    "90 % after: from the failure until the mean speed over a cycle is 90 % of the later one again.",
    "Where a robot makes no progress with six good legs, its walks are counted apart, in no other number.",
    "± is the standard error over worlds. Intervals of shares are Wilson's, 95 %, of walks taken to be "
    "independent.",
    "hexaheal: one leg or two lose their torque after 4 s of 14 s, on an even floor; recovered is a walk "
    "without a fall that has half of the commanded speed or more over its last 8 s. second: one leg does so "
    "after 8 s of 36 s and another 10 s later, in either order, judged by the same rule.",
)

HEADER = (
    "",
    "method",
    "walks",
    "right leg",
    "right kind, of those that matter",
    "alarm after: median, 95 of 100 (cycles)",
    "early alarms",
    "final: mean",
    "99 of 100",
    "greatest",
    "on the way: 99 of 100",
    "fell",
    "stopped",
    "no progress",
    "speed kept",
    "worst cell",
    "90 % after",
    "trials before, each",
)

RULE_TITLES = {HEXAHEAL: "HexaHeal's protocol", SECOND: "A second leg"}

RULE_HEADER = (
    "legs that fail",
    "method",
    "walks that recover",
    "fell or stopped",
    "sets of legs that recover",
)


def recovery_figure(findings: RecoveryFindings) -> "Figure":
    """Final deviation and speed kept, by kind of failure and method."""
    from matplotlib.figure import Figure

    groups = [(name, rows) for division, name, rows in findings.groups() if division == "kind"]
    methods = findings.plan.methods
    figure = Figure(figsize=(10.0, 1.2 + 0.25 * len(groups) * (len(methods) + 1)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    for place, method in enumerate(methods):
        color = METHOD_COLORS.get(method, OTHER_COLORS[place % len(OTHER_COLORS)])
        for row, (_, judged) in enumerate(groups):
            some = [one for one in judged if one.episode.case.method == method]
            height = row + 0.8 * (place + 0.5) / len(methods) - 0.4
            label = method if row == 0 else None
            final_cm = np.array([100 * one.episode.final_m for one in some])
            _spread(left, np.maximum(final_cm, LOW_CM), height, color, label)
            _spread(right, np.array([one.kept for one in some]), height, color, None)
    _finish(left, right, [name for name, _ in groups])
    robots = ", ".join(robot.name for robot in findings.plan.robots)
    worlds = len({row.world for row in findings.judged})
    title = f"{robots}, {worlds} unseen world{'s' * (worlds != 1)}, {findings.plan.duration_s:g} s"
    figure.suptitle(title, fontsize=11)
    if left.get_legend_handles_labels()[0]:
        figure.legend(loc="outside lower center", ncols=len(methods), fontsize=8)
    return figure


def _spread(panel: "Axes", values: FloatArray, height: float, color: str, label: str | None) -> None:
    """Draw the mean as a dot, the 1st to the 99th percentile as a line."""
    values = values[np.isfinite(values)]
    if not values.size:
        return
    low, high = np.percentile(values, [1, 99])
    panel.plot([low, high], [height, height], color=color, linewidth=2.0, alpha=0.6)
    panel.plot([values.mean()], [height], "o", color=color, markersize=5, label=label)


def _finish(left: "Axes", right: "Axes", names: Sequence[str]) -> None:
    left.set_xscale("log")
    left.set_xlim(left=LOW_CM)
    left.set_xlabel("deviation from the original line at the end in cm", fontsize=9)
    right.set_xlabel("later speed over that of the intact walk", fontsize=9)
    right.set_xlim(left=0.0)
    left.set_yticks(range(len(names)), names)
    left.set_ylim(len(names) - 0.5, -0.5)
    for panel in (left, right):
        panel.grid(visible=True, axis="x", linewidth=0.3)
        panel.tick_params(axis="y", length=0)


def write_recovery_report(findings: RecoveryFindings, folder: Path) -> Path:
    """Write table, figure and the report into a folder; path of the report."""
    _write_table(findings, folder)
    sections = [*_head(findings)]
    if LINE in findings.plan.protocols:
        save_figure(recovery_figure(findings), folder, FIGURE)
        here = "Dots are means, lines reach from the 1st to the 99th percentile."
        sections.append(
            Section(
                "Where walks end, and how fast",
                [Picture(folder / f"{FIGURE}.svg", "Not in the paper.", here)],
            )
        )
        sections += _tables(findings)
    for protocol in RULED:
        if protocol in findings.plan.protocols:
            sets = Table(("legs that fail", *findings.plan.methods), list(_set_rows(findings, protocol)))
            rows = Table(RULE_HEADER, list(_rule_rows(findings, protocol)))
            sections.append(Section(RULE_TITLES[protocol], [rows, sets]))
    versions = ", ".join(f"{name} {value}" for name, value in code_versions().items())
    page = render_page(
        "hexctl study --recovery", "Legs fail in mid-walk", [*sections, Section("Versions", [versions])]
    )
    atomic_write(folder / REPORT, page)
    return folder / REPORT


def recovery_json(findings: RecoveryFindings) -> dict[str, Any]:
    """Settings and results of a benchmark as JSON values; null where there is no number."""
    plan = findings.plan
    return {
        "robots": [robot.name for robot in plan.robots],
        "families": list(plan.families),
        "first_world": plan.first_world,
        "worlds": plan.worlds,
        "gaits": list(plan.gaits),
        "legs": list(plan.legs),
        "failures": list(plan.failures),
        "methods": list(plan.methods),
        "protocols": list(plan.protocols),
        "runs": plan.runs,
        "seed": plan.seed,
        "duration_s": plan.duration_s,
        "sensors": None if plan.exact_sensors else SENSORS,
        "code": code_versions(),
        "walks": len(findings.episodes),
        "set_aside": len(findings.set_aside),
        "bars": [bar.as_json() for bar in recovery_bars(findings)],
        "statistics": [
            {"division": division, "group": name, "method": method} | _numbers(found)
            for division, name, method, found in findings.table
        ],
        **_rule_json(findings, HEXAHEAL, (1, 2)),
        **_rule_json(findings, SECOND, (2,)),
    }


def _rule_json(findings: RecoveryFindings, protocol: str, counts: tuple[int, ...]) -> dict[str, Any]:
    """Walks that recover by the number of failed legs, and by set of legs."""
    methods = findings.plan.methods if protocol in findings.plan.protocols else ()
    return {
        protocol: [
            {"legs": legs, "method": method} | asdict(findings.rule_share(method, legs, protocol))
            for legs in counts
            for method in methods
        ],
        f"{protocol}_sets": [
            {"legs": list(legs), "method": method} | asdict(findings.rule_share(method, legs, protocol))
            for legs in findings.leg_sets(protocol)
            for method in methods
        ],
    }


def _numbers(found: RecoveryStatistics) -> dict[str, Any]:
    values = asdict(found)
    return {name: number(value) if isinstance(value, float) else value for name, value in values.items()}


def recovery_lines(findings: RecoveryFindings) -> list[str]:
    """Tables of all walks, by kind of failure and method, as lines of Markdown."""
    lines: list[str] = []
    if LINE in findings.plan.protocols:
        rows = [
            _row(name, method, found)
            for division, name, method, found in findings.table
            if division in ("all", "kind")
        ]
        lines += [*_markdown(HEADER, rows), *([text] if (text := _aside(findings)) else [])]
    for protocol in RULED:
        if protocol in findings.plan.protocols:
            header = (f"{protocol}: {RULE_HEADER[0]}", *RULE_HEADER[1:])
            lines += ["", *_markdown(header, list(_rule_rows(findings, protocol)))]
    return lines


def _markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = ["| " + " | ".join(header) + " |", "|---" * len(header) + "|"]
    return [*lines, *("| " + " | ".join(row) + " |" for row in rows)]


def _aside(findings: RecoveryFindings) -> str:
    """What was left out of all numbers, in words; empty for nothing."""
    rows = findings.set_aside
    if not rows:
        return ""
    places = dict.fromkeys(f"{row.place.robot.name} in {row.world}" for row in rows)
    return (
        f"counted apart: {len(rows)} walks in which the robot makes no progress with six good legs "
        f"({', '.join(places)})"
    )


def _head(findings: RecoveryFindings) -> Iterator[Section]:
    plan = findings.plan
    numbers = f"{plan.first_world} to {plan.first_world + plan.worlds - 1}"
    sensors = (
        "Sensors as the worlds have them."
        if plan.exact_sensors
        else "Sensors 40 ms late, with 1 cm and 0.5 degrees of noise; 5 % of the poses are lost."
    )
    settings = (
        f"{', '.join(robot.name for robot in plan.robots)}; gaits {', '.join(plan.gaits)}; worlds {numbers} "
        f"of {' and '.join(plan.families)}; legs {', '.join(map(str, plan.legs))}, each "
        f"{', '.join(plan.failures)}, within the gait cycle after 8 s of {plan.duration_s:g} s; "
        f"{len(findings.episodes)} walks. {sensors}"
    )
    texts = [settings, text] if (text := _aside(findings)) else [settings]
    yield Section("", texts)
    rows = [(bar.asked, bar.measured, bar.verdict) for bar in recovery_bars(findings)]
    yield Section("Bars", [Table(("asked", "measured", "verdict"), rows)])
    yield Section("How to read this", [Bullets(READING)])


def _tables(findings: RecoveryFindings) -> Iterator[Section]:
    """A table for each division of the walks."""
    rows: dict[str, list[tuple[str, ...]]] = {}
    for division, name, method, found in findings.table:
        rows.setdefault(division, []).append(_row(name, method, found))
    for division, lines in rows.items():
        yield Section("All" if division == "all" else f"By {division}", [Table(HEADER, lines)])


def _row(name: str, method: str, found: RecoveryStatistics) -> tuple[str, ...]:
    alarms = ("-",) * 4
    if method_of(method).notices:
        alarms = (
            counted(found.right_leg, found.episodes),
            counted(found.right_kind, found.matter),
            f"{found.delay_median:.2f}, {found.delay_p95:.2f}" if found.right_leg else "-",
            str(found.early),
        )
    return (
        name,
        method,
        f"{found.episodes} in {found.worlds} world{'s' * (found.worlds != 1)}",
        *alarms,
        cm(found.mean_m) + (f" ± {cm(found.mean_error_m)}" if np.isfinite(found.mean_error_m) else ""),
        cm(found.p99_m),
        cm(found.max_m),
        cm(found.way_p99_m),
        counted(found.fell, found.episodes) if found.fell else "0",
        str(found.others),
        str(found.no_progress),
        _with_error(found.kept, found.kept_error),
        f"{found.kept_worst:.2f}" if np.isfinite(found.kept_worst) else "-",
        f"{found.settled_median_s:.2f} s" if np.isfinite(found.settled_median_s) else "-",
        f"{found.trials / found.episodes:.3g}" if found.trials else "0",
    )


def _with_error(value: float, error: float) -> str:
    if not np.isfinite(value):
        return "-"
    return f"{value:.2f}" + (f" ± {error:.2f}" if np.isfinite(error) else "")


def _rule_rows(findings: RecoveryFindings, protocol: str) -> Iterator[tuple[str, ...]]:
    for legs, name in ((1, "one"), (2, "two")):
        for method in findings.plan.methods:
            found = findings.rule_share(method, legs, protocol)
            if found.walks:
                recovered = counted(found.recovered, found.walks)
                yield (name, method, recovered, str(found.fell), f"{found.sets} of {found.of_sets}")


def _set_rows(findings: RecoveryFindings, protocol: str) -> Iterator[tuple[str, ...]]:
    """Walks that recover of each set of legs, method by method."""
    for legs in findings.leg_sets(protocol):
        found = [findings.rule_share(method, legs, protocol) for method in findings.plan.methods]
        shares = [f"{one.recovered} of {one.walks}" for one in found]
        yield (" and ".join(map(str, legs)), *shares)


def _write_table(findings: RecoveryFindings, folder: Path) -> None:
    """Write a row for each walk."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    judged = {id(row.episode): row for row in (*findings.judged, *findings.set_aside)}
    rows = []
    for place, one in findings.episodes:
        where = {
            "protocol": place.protocol,
            "robot": place.robot.name,
            "family": place.family,
            "world": place.number,
            "kind_of_world": place.kind,
        }
        rows.append(where | episode_row(one) | _beside(judged.get(id(one))))
    table = pa.Table.from_pylist(rows)
    text, count, real = pa.string(), pa.int64(), pa.float64()
    alarm = {"at_s": real, "leg": count, "kind": text, "joint": text, "evidence": text}
    # Columns that may be empty have a type all the same, so that tables can be joined.
    types = {
        "alarms": pa.list_(pa.struct(list(alarm.items()))),
        "noticed_leg": count,
        "matters": pa.bool_(),
        **dict.fromkeys(("why", "noticed_kind", "noticed_joint", "noticed_evidence", "intact_status"), text),
        **dict.fromkeys(("delay_s", "delay_cycles", "final_m", "speed_kept"), real),
    }
    for name, kind in types.items():
        values = pa.array([row[name] for row in rows], type=kind)
        table = table.set_column(table.schema.get_field_index(name), name, values)
    pq.write_table(table, folder / TABLE)


def episode_row(episode: Episode) -> dict[str, Any]:
    """Values of an episode as one row: those of the case, of the walk, and of its first alarm."""
    values = asdict(episode)
    case = values.pop("case") | {"legs": list(episode.case.legs)}
    first = episode.alarms[0] if episode.alarms else None
    values["alarms"] = [asdict(alarm) for alarm in episode.alarms]
    noticed = {
        "noticed_leg": first.leg if first else None,
        "noticed_kind": first.kind if first else None,
        "noticed_joint": first.joint if first else None,
        "noticed_evidence": first.evidence if first else None,
        "delay_s": number(episode.delay_s),
        "delay_cycles": number(episode.delay_s * episode.pace_hz),
        "early_alarms": len(episode.early),
        "right_leg": episode.right_leg,
        "right_kind": episode.right_kind,
        "fell": episode.status == "fell",
        "final_m": number(episode.final_m),
        "recovered": episode.recovered,
    }
    row: dict[str, Any] = case | values | noticed
    return row


def _beside(row: Judged | None) -> dict[str, Any]:
    """What an episode is beside the intact walk; null for intact walks and other protocols."""
    if row is None:
        return {"matters": None, "speed_kept": None, "intact_status": None}
    return {"matters": row.matters, "speed_kept": number(row.kept), "intact_status": row.intact.status}
