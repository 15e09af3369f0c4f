"""Figures of the transfer benchmark: deviation over trials and over seconds walked."""

from typing import TYPE_CHECKING

import numpy as np

from hexctl.study.claim import cm
from hexctl.study.drawing import color_of, grid_of, label_axes, new_figure
from hexctl.study.transfer.findings import NEAR_M, NEARER_M, Curves, TransferFindings
from hexctl.study.transfer.plan import EARLY
from hexctl.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FLOOR_COLOR = "#888888"

#: Points of the curves over seconds.
SECONDS = 120


def trials_figure(findings: TransferFindings) -> "Figure":
    """Return mean, median and 90th percentile over trials, of all worlds and legs."""
    figure, panels = new_figure(1, 3, (13.0, 4.6))
    places = findings.places()
    trials = np.arange(1.0, findings.plan.budget + 1)
    for name in findings.plan.optimizers:
        _draw(panels, name, trials, findings.by_trials(name, places))
    _finish(figure, panels, findings, places, "trials", "All worlds and legs, over trials")
    return figure


def seconds_figure(findings: TransferFindings) -> "Figure":
    """Return mean, median and 90th percentile over the seconds walked."""
    figure, panels = new_figure(1, 3, (13.0, 4.6))
    places = findings.places()
    seconds = np.linspace(0, findings.plan.budget * findings.plan.duration_s, SECONDS + 1)[1:]
    for name in findings.plan.optimizers:
        _draw(panels, name, seconds, findings.by_seconds(name, places, seconds))
    _finish(figure, panels, findings, places, "seconds walked", "All worlds and legs, over seconds walked")
    return figure


def kinds_figure(findings: TransferFindings) -> "Figure":
    """Return the means over trials, one panel for each kind of world."""
    kinds = findings.kinds()
    rows, columns = grid_of(len(kinds))
    figure, panels = new_figure(rows, columns, (4.6 * columns + 0.6, 3.4 * rows + 0.8))
    trials = np.arange(1.0, findings.plan.budget + 1)
    for panel, kind in zip(panels, kinds, strict=False):
        places = findings.places(kind)
        for name in findings.plan.optimizers:
            _line(panel, name, trials, findings.by_trials(name, places).mean)
        _floor(panel, findings.floor_m(places))
        panel.set_title(f"{kind}, {len(places)} worlds and legs", fontsize=9)
    _label(figure, panels, len(kinds), "trials", "Mean, by the kind of world")
    return figure


def _draw(panels: "list[Axes]", name: str, across: FloatArray, curves: Curves) -> None:
    for panel, values in zip(panels, (curves.mean, curves.median, curves.p90), strict=True):
        _line(panel, name, across, values)


def _line(panel: "Axes", name: str, across: FloatArray, values: FloatArray) -> None:
    strong = name.startswith("bayes")
    style = "--" if name in (EARLY, "random") else "-"
    panel.plot(across, values, style, color=color_of(name), linewidth=2.2 if strong else 1.1, label=name)


def _floor(panel: "Axes", floor_m: float) -> None:
    panel.axhline(floor_m, color=FLOOR_COLOR, linewidth=1.2, linestyle=":", label="best of all gaits")


def _finish(
    figure: "Figure",
    panels: "list[Axes]",
    findings: TransferFindings,
    places: list[int],
    across: str,
    title: str,
) -> None:
    for panel, what in zip(panels, ("mean", "median", "nine of ten are below"), strict=True):
        _floor(panel, findings.floor_m(places))
        panel.set_title(f"{what};  best of all gaits {cm(findings.floor_m(places))}", fontsize=9)
    _label(figure, panels, 3, across, title)


def _label(figure: "Figure", panels: "list[Axes]", used: int, across: str, title: str) -> None:
    """Give all panels a logarithmic scale and labels, and the figure one legend."""
    for panel in panels[:used]:
        panel.set_yscale("log")
        for bound_m in (NEAR_M, NEARER_M):
            panel.axhline(bound_m, color="#C0392B", linewidth=0.5)
        panel.set_yticks([0.01, 0.025, 0.1, 0.5, 1.0], ["1 cm", "2.5 cm", "10 cm", "50 cm", "1 m"])
        panel.minorticks_off()
    label_axes(panels, used, across, "deviation of the best gait so far")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), fontsize=9, frameon=False)
    figure.suptitle(title, fontsize=11)
