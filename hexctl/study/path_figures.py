"""Figures of trajectories, seen from above: progress to the right, left of the line upward."""

from typing import TYPE_CHECKING, Any

import numpy as np

from hexctl.study.drawing import LINE_COLOR, grid_of, label_axes, new_figure
from hexctl.study.findings import Findings
from hexctl.study.landscape import Landscape
from hexctl.study.walk_claims import ends, within
from hexctl.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Final deviations at the ends of the colour scale, in m.
NEAR_M, FAR_M = 0.01, 3.0
COLORS = "viridis"

#: Width of a panel and of the colour bar, in inches.
PANEL_IN, BAR_IN = 4.3, 1.0

#: Legs whose examples the paper shows, and the arbitrary gait that stands for them without self-rotation.
EXAMPLE_LEGS, EXAMPLE_CODE = (2, 6), 57


def trajectories_figure(landscapes: list[Landscape], title: str) -> "Figure":
    """Return all trajectories of some landscapes, a panel each, coloured by final deviation."""
    rows, columns = grid_of(len(landscapes))
    figure, panels = new_figure(rows, columns, _size_in(landscapes, rows, columns))
    for panel, landscape in zip(panels, landscapes, strict=False):
        lines = _draw_paths(panel, landscape, np.arange(len(landscape.codes)))
        left, right = ends(landscape)
        valid, near = int(landscape.valid.sum()), within(landscape, 0.10)
        panel.set_title(
            f"leg {landscape.spec.leg}:  {left} left, {right} right,  {valid} valid, {near} within 10 cm",
            fontsize=9,
        )
    _finish(figure, panels, len(landscapes), title)
    _add_bar(figure, panels, lines)
    return figure


def best_figure(findings: Findings) -> "Figure":
    """Return the best gaits that the optimizers found over all runs, by the paper's count."""
    legs = findings.plan.legs
    rows, columns = grid_of(len(legs))
    figure, panels = new_figure(rows, columns, (PANEL_IN * columns + BAR_IN, 2.6 * rows + 0.5))
    for panel, leg in zip(panels, legs, strict=False):
        landscape = findings.rotated(leg)
        codes, times = _found(findings, leg)
        chosen = [landscape.row_of(code) for code in codes.tolist()]
        lines = _draw_paths(
            panel, landscape, np.array(chosen, dtype=int), 0.8 + 2.2 * times / max(1, times.max(initial=1))
        )
        panel.set_title(f"leg {leg}:  {len(codes)} different gaits in {times.sum()} runs", fontsize=9)
    title = "Best trajectories found, over all optimizers and runs (sideways stretched)"
    _finish(figure, panels, len(legs), title, equal=False)
    _add_bar(figure, panels, lines)
    return figure


def examples_figure(findings: Findings) -> "Figure | None":
    """Return single trajectories of legs 2 and 6, before and after; None when neither leg was studied."""
    legs = [leg for leg in EXAMPLE_LEGS if leg in findings.plan.legs]
    if not legs:
        return None
    figure, panels = new_figure(len(legs), 2, (11.0, 3.2 * len(legs) + 0.4))
    for row, leg in enumerate(legs):
        best = _best_row(findings.rotated(leg))
        pairs = [(findings.without(leg), EXAMPLE_CODE - 1), (findings.rotated(leg), best)]
        for panel, (landscape, chosen) in zip(panels[2 * row :], pairs, strict=False):
            _draw_example(panel, landscape, chosen)
    _finish(figure, panels, len(panels), "Left: an arbitrary gait. Right: self-rotation and the best gait")
    return figure


def _best_row(landscape: Landscape) -> int:
    return int(landscape.scores.argmin())


def _found(findings: Findings, leg: int) -> "tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]":
    """Return the codes that were the best of a run, and how many runs each."""
    best = [findings.searches[leg, name, True].best_codes for name in findings.plan.optimizers]
    return np.unique(np.concatenate(best), return_counts=True)


def _points(landscape: Landscape, row: int) -> FloatArray:
    """Return a path from its origin, (P, 2), without what was never walked."""
    path = landscape.paths_m[row]
    return np.concatenate([np.zeros((1, 2)), path[np.isfinite(path[:, 0])]])


def _draw_paths(
    panel: "Axes", landscape: Landscape, rows: "np.ndarray[Any, Any]", widths: "FloatArray | float" = 0.9
) -> Any:
    """Draw the paths of some rows, the best on top and invalid ones grey; return what a colour bar needs."""
    from matplotlib.collections import LineCollection
    from matplotlib.colors import LogNorm

    ordered = np.argsort(-landscape.scores[rows], kind="stable")
    widths = np.broadcast_to(widths, rows.shape)[ordered]
    rows = rows[ordered]
    valid = landscape.valid[rows]
    grey = LineCollection([_points(landscape, row) for row in rows[~valid]], colors="#BBBBBB", linewidths=0.5)
    panel.add_collection(grey)
    lines = LineCollection(
        [_points(landscape, row) for row in rows[valid]],
        array=landscape.final_m[rows][valid],
        cmap=COLORS,
        norm=LogNorm(NEAR_M, FAR_M),
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
    """Return width and height of a figure whose panels hold all paths at equal scales."""
    points = np.concatenate([landscape.paths_m.reshape(-1, 2) for landscape in landscapes])
    points = np.concatenate([np.zeros((1, 2)), points[np.isfinite(points[:, 0])]])
    wide, high = np.ptp(points, axis=0)
    panel_in = PANEL_IN * float(np.clip(high / max(wide, 1e-6), 0.4, 1.6))
    return PANEL_IN * columns + BAR_IN + 0.4, (panel_in + 0.35) * rows + 0.6


def _add_bar(figure: "Figure", panels: "list[Axes]", lines: Any) -> None:
    bar = figure.colorbar(lines, ax=panels, shrink=0.8, pad=0.01, extend="both")
    bar.set_label("deviation at the end", fontsize=9)
    bar.set_ticks(
        [0.01, 0.025, 0.1, 0.3, 1.0, 3.0], labels=["1 cm", "2.5 cm", "10 cm", "30 cm", "1 m", "3 m"]
    )
    bar.minorticks_off()


def _finish(figure: "Figure", panels: "list[Axes]", used: int, title: str, *, equal: bool = True) -> None:
    """Give all panels the line of travel and labels, and equal scales unless told otherwise."""
    for panel in panels[:used]:
        panel.axhline(0, color=LINE_COLOR, linewidth=0.8, zorder=0)
        panel.plot(0, 0, "o", color=LINE_COLOR, markersize=4)
        if equal:
            panel.set_aspect("equal", adjustable="box")
    label_axes(panels, used, "progress along the heading in m", "to the left of the line in m")
    figure.suptitle(title, fontsize=11)
