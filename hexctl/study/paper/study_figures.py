"""Figures of a study: paths seen from above, and best-so-far over evaluations."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hexctl.palette import (
    BAR_COLOR,
    BEST_OF_ALL_COLOR,
    INVALID_COLOR,
    LEGEND_M,
    LINE_COLOR,
    OPTIMIZER_COLORS,
    OPTIMIZER_DASHES,
    OTHER_OPTIMIZER_COLORS,
    OTHER_OPTIMIZER_DASHES,
    hex_color,
    scale_stops,
)
from hexctl.study.experiment import Drawing, where
from hexctl.study.landscape import Landscape
from hexctl.study.paper.evidence import EARLY_M, LATE_M, cm
from hexctl.study.paper.searches import Findings
from hexctl.study.paper.study_plan import BASELINE
from hexctl.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

#: Width of a panel and of the colour bar, in inches.
PANEL_IN, BAR_IN = 4.3, 1.0

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
    """Best gaits of the optimizers over all runs."""

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
        panel.axhline(0, color=hex_color(LINE_COLOR), linewidth=0.8, zorder=0)
        panel.plot(0, 0, "o", color=hex_color(LINE_COLOR), markersize=4)
        if equal:
            panel.set_aspect("equal", adjustable="box")
    label_axes(panels, len(each), "progress along the heading in m", "to the left of the line in m")
    figure.suptitle(title, fontsize=11, wrap=True)
    bar = figure.colorbar(lines, ax=panels, shrink=0.8, pad=0.01, extend="both")
    bar.set_label("deviation at the end", fontsize=9)
    bar.set_ticks(list(LEGEND_M), labels=["1 cm", "2.5 cm", "10 cm", "30 cm", "1 m", "3 m"])
    bar.minorticks_off()
    return figure


def _best_codes(findings: Findings, leg: int) -> "tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]":
    """Best codes of runs, and the number of runs of each."""
    runs = where(findings.first_runs, leg=leg)
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


def _size_in(landscapes: list[Landscape], rows: int, columns: int) -> tuple[float, float]:
    """Width and height, in inches, at which all paths fit at equal scales."""
    points = np.concatenate([landscape.paths_m.reshape(-1, 2) for landscape in landscapes])
    points = np.concatenate([np.zeros((1, 2)), points[np.isfinite(points[:, 0])]])
    wide, high = np.ptp(points, axis=0)
    panel_in = PANEL_IN * float(np.clip(high / max(wide, 1e-6), 0.4, 1.6))
    return PANEL_IN * columns + BAR_IN + 0.4, (panel_in + 0.35) * rows + 0.6


#: Lower end of the scale; smaller deviations mean nothing for a robot.
LOW_M = 0.002

#: Width of a legend's entry, in inches.
LEGEND_ENTRY_IN = 2.0


def convergence_figure(findings: Findings) -> "Figure":
    """One panel per leg with the mean of every optimizer."""
    legs = findings.searched
    rows, columns = grid_of(len(legs))
    figure, panels = new_figure(rows, columns, (4.6 * columns + 0.6, 3.4 * rows + 0.8))
    for panel, leg in zip(panels, legs, strict=False):
        _draw_curves(panel, findings, leg)
    label_axes(panels, len(legs), "evaluations", "deviation from the line")
    handles, labels = panels[0].get_legend_handles_labels()
    columns = min(len(labels), max(2, int(figure.get_figwidth() / LEGEND_ENTRY_IN)))
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, fontsize=9, frameon=False)
    title = f"Mean of the best deviation over {findings.plan.runs} runs, repetitions counted"
    figure.suptitle(title, fontsize=11, wrap=True)
    return figure


def _draw_curves(panel: "Axes", findings: Findings, leg: int) -> None:
    """Draw the mean of every optimizer, and the best of all gaits, on a logarithmic scale."""
    for name in findings.plan.optimizers:
        curve = findings.curves[leg, name]
        panel.plot(curve.index, curve["mean_m"], linewidth=1.4, label=name, **line_of(name))
        if name == BASELINE:
            _draw_spread(panel, name, curve)
    best_m = findings.rotated(leg).best_m
    color = hex_color(BEST_OF_ALL_COLOR)
    panel.axhline(best_m, color=color, linewidth=1.2, linestyle=":", label="best of all gaits")
    for bound_m in (LATE_M, EARLY_M):
        panel.axhline(bound_m, color=hex_color(BAR_COLOR), linewidth=0.5)
    below = " (below the scale)" if best_m < LOW_M else ""
    panel.set_title(f"leg {leg}:  best of all gaits {cm(best_m)}{below}", fontsize=9)
    panel.set_yscale("log")
    panel.set_yticks([0.01, 0.025, 0.1, 0.5, 1.0], ["1 cm", "2.5 cm", "10 cm", "50 cm", "1 m"])
    panel.minorticks_off()
    panel.set_ylim(bottom=LOW_M)


def line_of(optimizer: str) -> dict[str, Any]:
    """Colour and dashes of an optimizer's lines, as keywords of matplotlib; the same in all figures."""
    others = OTHER_OPTIMIZER_COLORS
    color = OPTIMIZER_COLORS.get(optimizer, others[sum(optimizer.encode()) % len(others)])
    usual = () if optimizer in OPTIMIZER_COLORS else OTHER_OPTIMIZER_DASHES
    dashes = OPTIMIZER_DASHES.get(optimizer, usual)
    return {"color": hex_color(color), "linestyle": (0, dashes) if dashes else "-"}


def _draw_spread(panel: "Axes", name: str, curve: "DataFrame") -> None:
    """Shade the 10th to 90th percentile of the runs; six such bands would hide one another."""
    label = f"{name}, 10-90 % of the runs"
    panel.fill_between(
        curve.index, curve["p10_m"], curve["p90_m"], color="#000000", alpha=0.08, lw=0, label=label
    )


def study_drawings(findings: Findings) -> dict[str, Drawing]:
    """Return the figures of a study, by their name in `captions`."""
    return {
        "trajectories_without_self_rotation": lambda: _all_gaits(findings, turned=False),
        "trajectories_with_self_rotation": lambda: _all_gaits(findings, turned=True),
        "convergence": lambda: convergence_figure(findings),
        "best_trajectories": lambda: best_figure(findings),
    }


def _all_gaits(findings: Findings, *, turned: bool) -> "Figure | None":
    if turned and findings.plan.self_rotation == "none":
        return None
    landscape_of = findings.rotated if turned else findings.without
    title = f"All gaits, {'with' if turned else 'without'} self-rotation"
    return trajectories_figure([landscape_of(leg) for leg in findings.plan.legs], title)


def new_figure(rows: int, columns: int, size_in: tuple[float, float]) -> "tuple[Figure, list[Axes]]":
    """Figure and its panels, row by row, with shared axes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=size_in, layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    return figure, list(panels.flat)


def label_axes(panels: "list[Axes]", used: int, across: str, up: str) -> None:
    """Label the axes of the outer panels in use and hide the others."""
    columns = panels[0].get_subplotspec().get_gridspec().ncols  # type: ignore[union-attr]
    for number, panel in enumerate(panels):
        panel.set_visible(number < used)
        panel.grid(visible=True, linewidth=0.3)
        if number + columns >= used:
            panel.set_xlabel(across, fontsize=9)
            panel.tick_params(labelbottom=True)
        if number % columns == 0:
            panel.set_ylabel(up, fontsize=9)


def grid_of(count: int) -> tuple[int, int]:
    """Rows and columns for a number of panels, up to three in a row."""
    columns = min(3, count)
    return -(-count // columns), columns
