"""Figures of convergence: mean best-so-far against evaluations."""

from typing import TYPE_CHECKING

import numpy as np

from hexctl.study.bars import EARLY, EARLY_M, LATE, LATE_M
from hexctl.study.claim import cm
from hexctl.study.convergence import Curve, Searches
from hexctl.study.drawing import color_of, grid_of, label_axes, new_figure
from hexctl.study.findings import Findings
from hexctl.study.plan import BASELINE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FLOOR_COLOR = "#888888"

#: Lower end of the scale: less than this says nothing about a robot.
LOW_M = 0.002


def convergence_figure(findings: Findings, *, paper_count: bool) -> "Figure":
    """Return one panel per leg with the mean of every optimizer, by one of the two counts."""
    legs = findings.plan.legs
    rows, columns = grid_of(len(legs))
    figure, panels = new_figure(rows, columns, (4.6 * columns + 0.6, 3.4 * rows + 0.8))
    for panel, leg in zip(panels, legs, strict=False):
        for name in findings.plan.optimizers:
            search = findings.searches[leg, name, paper_count]
            _draw_curve(panel, name, search.curve)
            _draw_spread(panel, name, search.curve)
            _mark_stuck(panel, search)
        best = findings.rotated(leg).best_m
        panel.axhline(best, color=FLOOR_COLOR, linewidth=1.2, linestyle=":", label="best of all gaits")
        below = " (below the scale)" if best < LOW_M else ""
        panel.set_title(f"leg {leg}:  best of all gaits {cm(best)}{below}", fontsize=9)
    counted = "repetitions counted (the paper's count)" if paper_count else "each gait paid for once"
    _finish(
        figure, panels, len(legs), f"Mean of the best deviation over {findings.plan.runs} runs, {counted}"
    )
    return figure


def means_figure(findings: Findings) -> "Figure":
    """Return the means over all legs and runs, by both counts, with the project's bars."""
    figure, panels = new_figure(1, 2, (11.0, 4.2))
    best = float(np.mean([findings.rotated(leg).best_m for leg in findings.plan.legs]))
    for panel, paper_count in zip(panels, (True, False), strict=True):
        for name in findings.plan.optimizers:
            _draw_curve(panel, name, findings.mean_curve(name, paper_count=paper_count))
        panel.axhline(best, color=FLOOR_COLOR, linewidth=1.2, linestyle=":", label="best of all gaits")
        panel.plot([EARLY, LATE], [EARLY_M, LATE_M], "v", color="#C0392B", markersize=7, label="bars")
        panel.set_title("repetitions counted" if paper_count else "each gait paid for once", fontsize=9)
    _finish(figure, panels, 2, "Mean over all legs and runs")
    return figure


def _draw_curve(panel: "Axes", name: str, curve: Curve) -> None:
    evaluations = np.arange(1, len(curve.mean) + 1)
    style = "--" if name == BASELINE else "-"
    panel.plot(evaluations, curve.mean, style, color=color_of(name), linewidth=1.4, label=name)


def _draw_spread(panel: "Axes", name: str, curve: Curve) -> None:
    """Shade where eight of ten runs of the random baseline are; six such bands would hide one another."""
    if name == BASELINE:
        evaluations = np.arange(1, len(curve.mean) + 1)
        label = f"{name}, 10-90 % of the runs"
        panel.fill_between(evaluations, curve.p10, curve.p90, color="#000000", alpha=0.08, lw=0, label=label)


def _mark_stuck(panel: "Axes", search: Searches) -> None:
    """Put a dot where the search, on average, has no codes of its own left and random ones go on."""
    stuck = float(search.own_codes.mean())
    if not search.paper_count and search.optimizer != BASELINE and stuck < len(search.curve.mean):
        value = search.curve.mean[round(stuck) - 1]
        panel.plot(stuck, value, "o", color=color_of(search.optimizer), markersize=4)


def _finish(figure: "Figure", panels: "list[Axes]", used: int, title: str) -> None:
    """Give all panels a logarithmic scale and labels, and the figure one legend."""
    for panel in panels[:used]:
        panel.set_yscale("log")
        panel.axhline(LATE_M, color="#C0392B", linewidth=0.5)
        panel.axhline(EARLY_M, color="#C0392B", linewidth=0.5)
        panel.set_yticks([0.01, 0.025, 0.1, 0.5, 1.0], ["1 cm", "2.5 cm", "10 cm", "50 cm", "1 m"])
        panel.minorticks_off()
        panel.set_ylim(bottom=LOW_M)
    label_axes(panels, used, "evaluations", "deviation from the line")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), fontsize=9, frameon=False)
    figure.suptitle(title, fontsize=11)
