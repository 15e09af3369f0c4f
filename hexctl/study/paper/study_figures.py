"""Figures of a study: paths seen from above, and best-so-far over evaluations."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hexctl.palette import (
    BAR_COLOR,
    GREY,
    INVALID_COLOR,
    LEGEND_M,
    LINE_COLOR,
    VERDICT_COLORS,
    baseline_color,
    hex_color,
    scale_stops,
)
from hexctl.study.data_frames import where
from hexctl.study.experiment import Drawing
from hexctl.study.figure_style import (
    color_of,
    draw_curves,
    finish_curves,
    grid_of,
    label_axes,
    new_figure,
)
from hexctl.study.landscape import Landscape
from hexctl.study.paper.evidence import EARLY, EARLY_M, LATE, LATE_M, cm
from hexctl.study.paper.searches import ALL, FRESH, PAPER, Findings
from hexctl.study.paper.study_report import default_text
from hexctl.study.paper.study_settings import BASELINE
from hexctl.study.report_page import texts
from hexctl.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame, Series

#: Width of a panel and of the colour bar, in inches.
PANEL_IN, BAR_IN = 4.3, 1.0

#: Opacity of a verdict without an interval.
PALE = 0.4

#: Legs whose examples the paper shows, and the arbitrary gait that stands for them without self-rotation.
EXAMPLE_LEGS, EXAMPLE_CODE = (2, 6), 57


#: Title, landscape, rows and line widths of the paths in a panel.
Paths = tuple[str, Landscape, "np.ndarray[Any, Any]", "FloatArray | float"]


def trajectories_figure(landscapes: list[Landscape], title: str) -> "Figure":
    """All trajectories of some landscapes, one panel each, coloured by final deviation."""

    def paths(landscape: Landscape) -> Paths:
        left, right = landscape.ends
        ends = f"leg {landscape.spec.leg}:  {left} left, {right} right"
        valid, near = int(landscape.valid.sum()), landscape.within(EARLY_M)
        name = f"{ends},  {valid} valid, {near} within 10 cm"
        return name, landscape, np.arange(len(landscape.codes)), 0.9

    size_in = _size_in(landscapes, *grid_of(len(landscapes)))
    return _paths_figure([paths(one) for one in landscapes], size_in, title)


def best_figure(findings: Findings) -> "Figure":
    """Best gaits of the optimizers over all runs, by the paper's count."""

    def paths(leg: int) -> Paths:
        codes, times = _best_codes(findings, leg)
        landscape = findings.rotated(leg)
        chosen = np.array([landscape.row_of(code) for code in codes.tolist()], dtype=int)
        name = f"leg {leg}:  {len(codes)} different gaits in {times.sum()} runs"
        return name, landscape, chosen, 0.8 + 2.2 * times / max(1, times.max(initial=1))

    rows, columns = grid_of(len(findings.searched))
    size_in = (PANEL_IN * columns + BAR_IN, 2.6 * rows + 0.5)
    title = "Best trajectories found, over all optimizers and runs (sideways stretched)"
    return _paths_figure([paths(leg) for leg in findings.searched], size_in, title, equal=False)


def _paths_figure(
    each: Sequence[Paths], size_in: tuple[float, float], title: str, *, equal: bool = True
) -> "Figure":
    figure, panels = new_figure(*grid_of(len(each)), size_in)
    for panel, (name, landscape, rows, widths) in zip(panels, each, strict=False):
        lines = _draw_paths(panel, landscape, rows, widths)
        panel.set_title(name, fontsize=9)
    _finish_paths(figure, panels, len(each), title, equal=equal)
    bar = figure.colorbar(lines, ax=panels, shrink=0.8, pad=0.01, extend="both")
    bar.set_label("deviation at the end", fontsize=9)
    bar.set_ticks(list(LEGEND_M), labels=["1 cm", "2.5 cm", "10 cm", "30 cm", "1 m", "3 m"])
    bar.minorticks_off()
    return figure


def examples_figure(findings: Findings) -> "Figure | None":
    """Single trajectories of legs 2 and 6, without and with self-rotation; None without these legs."""
    legs = [leg for leg in EXAMPLE_LEGS if leg in findings.plan.legs]
    if not legs:
        return None
    figure, panels = new_figure(len(legs), 2, (11.0, 3.2 * len(legs) + 0.4))
    for row, leg in enumerate(legs):
        plain, turned = findings.without(leg), findings.rotated(leg)
        example = plain.row_of(EXAMPLE_CODE) if EXAMPLE_CODE in plain.spec.codes else 0
        pairs = [(plain, example), (turned, int(turned.scores.argmin()))]
        for panel, (landscape, chosen) in zip(panels[2 * row :], pairs, strict=False):
            _draw_example(panel, landscape, chosen)
    _finish_paths(
        figure, panels, len(panels), "Left: an arbitrary gait. Right: self-rotation and the best gait"
    )
    return figure


def _best_codes(findings: Findings, leg: int) -> "tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]":
    """Best codes of runs, and the number of runs of each."""
    runs = where(findings.first_runs, leg=leg, count=PAPER)
    found = runs[[np.isfinite(best_m[-1]) for best_m in runs["best_m"]]]
    best = [codes[scores.argmin()] for codes, scores in zip(found["codes"], found["scores"], strict=True)]
    return np.unique(np.array(best, dtype=int), return_counts=True)


def _points(landscape: Landscape, row: int) -> FloatArray:
    """Path from its origin as far as it was walked, (P, 2)."""
    path = landscape.paths_m[row]
    return np.concatenate([np.zeros((1, 2)), path[np.isfinite(path[:, 0])]])


def _draw_paths(
    panel: "Axes", landscape: Landscape, rows: "np.ndarray[Any, Any]", widths: "FloatArray | float"
) -> Any:
    """Draw the paths of some rows, the best on top, invalid ones grey; return what a colour bar needs."""
    from matplotlib.collections import LineCollection
    from matplotlib.colors import LinearSegmentedColormap, LogNorm

    ordered = np.argsort(-landscape.scores[rows], kind="stable")
    widths = np.broadcast_to(widths, rows.shape)[ordered]
    rows = rows[ordered]
    valid = landscape.valid[rows]
    grey = LineCollection(
        [_points(landscape, row) for row in rows[~valid]], colors=hex_color(INVALID_COLOR), linewidths=0.4
    )
    panel.add_collection(grey)
    lines = LineCollection(
        [_points(landscape, row) for row in rows[valid]],
        array=landscape.final_m[rows][valid],
        cmap=LinearSegmentedColormap.from_list("deviation", scale_stops()),
        norm=LogNorm(LEGEND_M[0], LEGEND_M[-1]),
        linewidths=widths[valid],
    )
    panel.add_collection(lines)
    panel.autoscale_view()
    return lines


def _draw_example(panel: "Axes", landscape: Landscape, row: int) -> None:
    points = _points(landscape, row)
    panel.plot(points[:, 0], points[:, 1], color="#1F4E79", linewidth=1.8)
    panel.plot(points[::25, 0], points[::25, 1], "o", color="#1F4E79", markersize=3)
    slots = ",".join(str(slot) for slot in landscape.spec.space.slots_of(int(landscape.codes[row])))
    off = f"{landscape.number('signed_m')[row]:+.3f} m"
    ends = off if landscape.valid[row] else f"{off}, invalid ({landscape.status[row]})"
    panel.set_title(f"{landscape.spec.title}, code {landscape.codes[row]} ({slots}): {ends}", fontsize=9)


def _size_in(landscapes: list[Landscape], rows: int, columns: int) -> tuple[float, float]:
    """Width and height, in inches, at which all paths fit at equal scales."""
    points = np.concatenate([landscape.paths_m.reshape(-1, 2) for landscape in landscapes])
    points = np.concatenate([np.zeros((1, 2)), points[np.isfinite(points[:, 0])]])
    wide, high = np.ptp(points, axis=0)
    panel_in = PANEL_IN * float(np.clip(high / max(wide, 1e-6), 0.4, 1.6))
    return PANEL_IN * columns + BAR_IN + 0.4, (panel_in + 0.35) * rows + 0.6


def _finish_paths(
    figure: "Figure", panels: "list[Axes]", used: int, title: str, *, equal: bool = True
) -> None:
    for panel in panels[:used]:
        panel.axhline(0, color=hex_color(LINE_COLOR), linewidth=0.8, zorder=0)
        panel.plot(0, 0, "o", color=hex_color(LINE_COLOR), markersize=4)
        if equal:
            panel.set_aspect("equal", adjustable="box")
    label_axes(panels, used, "progress along the heading in m", "to the left of the line in m")
    figure.suptitle(title, fontsize=11, wrap=True)


#: Lower end of the scale; smaller deviations mean nothing for a robot.
LOW_M = 0.002


def convergence_figure(findings: Findings, count: str) -> "Figure":
    """One panel per leg with the mean of every optimizer, by one of the two counts."""
    legs = findings.searched
    rows, columns = grid_of(len(legs))
    figure, panels = new_figure(rows, columns, (4.6 * columns + 0.6, 3.4 * rows + 0.8))
    for panel, leg in zip(panels, legs, strict=False):
        best = findings.rotated(leg).best_m
        draw_curves(panel, _mean_curves(findings, leg, count), best, 1.4)
        for name in findings.plan.optimizers:
            curve = findings.curves[leg, name, count]
            if name == BASELINE:
                _draw_spread(panel, name, curve)
            elif count == FRESH:
                runs = where(findings.first_runs, leg=leg, optimizer=name, count=count)
                _mark_stuck(panel, name, curve, float(runs["own_codes"].mean()))
        own = _draw_defaults(panel, findings, leg)
        panel.set_title("\n".join([f"leg {leg}:  best of all gaits {_on_scale(best)}", *own]), fontsize=9)
    counted = "repetitions counted (the paper's count)" if count == PAPER else "each gait paid for once"
    title = f"Mean of the best deviation over {findings.plan.runs} runs, {counted}"
    _finish_curves(figure, panels, len(legs), title)
    return figure


def _draw_defaults(panel: "Axes", findings: Findings, leg: int) -> list[str]:
    """Draw where the robot's own gaits end, as level lines; return their values as text."""
    if findings.default_walks is None:
        return []
    ends = []
    for walk in where(findings.default_walks, leg=leg).itertuples():
        # An invalid one has an entry in the legend, too, because all panels share it.
        color, label = hex_color(baseline_color(walk.gait)), f"{walk.gait}, without a search"
        panel.axhline(walk.final_m, color=color, linewidth=1.4, linestyle="-.", label=label)
        ends.append(f"{walk.gait} {default_text(walk)}{_below_scale(walk.final_m)}")
    return [f"without a search: {', '.join(ends)}"]


def _on_scale(value_m: float) -> str:
    return cm(value_m) + _below_scale(value_m)


def _below_scale(value_m: float) -> str:
    return " (below the scale)" if value_m < LOW_M else ""


def means_figure(findings: Findings) -> "Figure":
    """Means over all legs and runs, by both counts, with the project's bars."""
    figure, panels = new_figure(1, 2, (11.0, 4.2))
    best = float(np.mean([findings.rotated(leg).best_m for leg in findings.searched]))
    for panel, count in zip(panels, (PAPER, FRESH), strict=True):
        draw_curves(panel, _mean_curves(findings, ALL, count), best, 1.4)
        panel.plot(
            [EARLY, LATE], [EARLY_M, LATE_M], "v", color=hex_color(BAR_COLOR), markersize=7, label="bars"
        )
        panel.set_title("repetitions counted" if count == PAPER else "each gait paid for once", fontsize=9)
    _finish_curves(figure, panels, 2, "Mean over all legs and runs")
    return figure


def _mean_curves(findings: Findings, leg: int, count: str) -> "dict[str, Series[float]]":
    return {name: findings.curves[leg, name, count]["mean_m"] for name in findings.plan.optimizers}


def _draw_spread(panel: "Axes", name: str, curve: "DataFrame") -> None:
    """Shade the 10th to 90th percentile of the runs; six such bands would hide one another."""
    label = f"{name}, 10-90 % of the runs"
    panel.fill_between(
        curve.index, curve["p10_m"], curve["p90_m"], color="#000000", alpha=0.08, lw=0, label=label
    )


def _mark_stuck(panel: "Axes", name: str, curve: "DataFrame", stuck: float) -> None:
    """Mark the mean number of codes after which a search is stuck and random codes take over."""
    if stuck < len(curve):
        panel.plot(stuck, curve["mean_m"][round(stuck)], "o", color=color_of(name), markersize=4)


def _finish_curves(figure: "Figure", panels: "list[Axes]", used: int, title: str) -> None:
    finish_curves(figure, panels, used, "evaluations", "deviation from the line", title)
    for panel in panels[:used]:
        panel.set_ylim(bottom=LOW_M)


def verdicts_figure(rows: Sequence[tuple[str, Sequence[str]]], columns: Sequence[str]) -> "Figure":
    """Verdicts as coloured squares: a row for each setting, a column for each claim.

    Verdicts in brackets, for which no interval was tested, are pale.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(0.55 * len(columns) + 3.4, 0.3 * len(rows) + 2.0), layout="constrained")
    panel = figure.subplots()
    for row, (_, verdicts) in enumerate(rows):
        for column, verdict in enumerate(verdicts):
            panel.add_patch(_square(column, row, verdict))
    panel.set_xlim(-0.5, len(columns) - 0.5)
    panel.set_ylim(len(rows) - 0.5, -0.5)
    panel.set_xticks(range(len(columns)), columns, rotation=40, ha="right", fontsize=8)
    panel.set_yticks(range(len(rows)), [title for title, _ in rows], fontsize=8)
    panel.tick_params(length=0)
    names = [*VERDICT_COLORS, "not judged"]
    shown = {verdict for _, verdicts in rows for verdict in verdicts}
    names += [f"({name})" for name in VERDICT_COLORS if f"({name})" in shown]
    keys = [_square(0, 0, name, name) for name in names]
    figure.legend(handles=keys, loc="outside upper center", ncols=4, fontsize=8, frameon=False)
    return figure


def _square(column: int, row: int, verdict: str, label: str = "") -> Any:
    from matplotlib.patches import Rectangle

    corner, judged = (column - 0.46, row - 0.46), verdict.strip("()") in VERDICT_COLORS
    color = hex_color(VERDICT_COLORS[verdict.strip("()")] if judged else GREY)
    alpha = PALE if verdict.startswith("(") else 1.0
    return Rectangle(corner, 0.92, 0.92, fill=judged, color=color, alpha=alpha, label=label)


def study_drawings(findings: Findings) -> list[Drawing]:
    """Return the figures of a study."""
    draw = {
        "trajectories_without_self_rotation": lambda: _all_gaits(findings, turned=False),
        "trajectories_with_self_rotation": lambda: _all_gaits(findings, turned=True),
        "examples": lambda: examples_figure(findings),
        "convergence_paper_count": lambda: convergence_figure(findings, PAPER),
        "convergence_fresh_count": lambda: convergence_figure(findings, FRESH),
        "convergence_means": lambda: means_figure(findings),
        "best_trajectories": lambda: best_figure(findings),
    }
    captions = texts("captions")
    return [Drawing(name=name, draw=figure, **captions[name]) for name, figure in draw.items()]


def _all_gaits(findings: Findings, *, turned: bool) -> "Figure | None":
    if turned and findings.plan.self_rotation == "none":
        return None
    landscape_of = findings.rotated if turned else findings.without
    title = f"All gaits, {'with' if turned else 'without'} self-rotation"
    return trajectories_figure([landscape_of(leg) for leg in findings.plan.legs], title)
