"""Shared parts of figures: matplotlib without a window, colours, saving."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hexctl.errors import MissingExtraError
from hexctl.palette import (
    BAR_COLOR,
    BEST_OF_ALL_COLOR,
    OPTIMIZER_COLORS,
    OPTIMIZER_DASHES,
    OTHER_OPTIMIZER_COLORS,
    OTHER_OPTIMIZER_DASHES,
    hex_color,
)
from hexctl.study.paper.evidence import EARLY_M, LATE_M

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import Series


def check_drawing() -> None:
    """Raise MissingExtraError unless figures, tables and reports can be written."""
    try:
        import jinja2  # noqa: F401
        import matplotlib  # noqa: F401
        import pandas  # noqa: F401
        import pyarrow  # noqa: F401
    except ModuleNotFoundError as error:
        raise MissingExtraError("hexctl study", "study") from error


def line_of(optimizer: str) -> dict[str, Any]:
    """Colour and dashes of an optimizer's lines, as keywords of matplotlib; the same in all figures."""
    others = OTHER_OPTIMIZER_COLORS
    color = OPTIMIZER_COLORS.get(optimizer, others[sum(optimizer.encode()) % len(others)])
    usual = () if optimizer in OPTIMIZER_COLORS else OTHER_OPTIMIZER_DASHES
    dashes = OPTIMIZER_DASHES.get(optimizer, usual)
    return {"color": hex_color(color), "linestyle": (0, dashes) if dashes else "-"}


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


#: Width of a legend's entry, in inches.
LEGEND_ENTRY_IN = 2.0


def draw_curves(panel: "Axes", curves: "Mapping[str, Series[float]]", floor_m: float, width: float) -> None:
    """Draw a curve for each optimizer, `bayes` bold, above the deviation of the best of all gaits."""
    for optimizer, curve in curves.items():
        bold = 2 * width if optimizer.startswith("bayes") else width
        panel.plot(curve.index, curve, linewidth=bold, label=optimizer, **line_of(optimizer))
    color = hex_color(BEST_OF_ALL_COLOR)
    panel.axhline(floor_m, color=color, linewidth=1.2, linestyle=":", label="best of all gaits")


def finish_curves(
    figure: "Figure", panels: "list[Axes]", used: int, across: str, up: str, title: str
) -> None:
    """Give all panels a logarithmic scale of deviations and labels, and the figure one legend."""
    for panel in panels[:used]:
        panel.set_yscale("log")
        for bound_m in (LATE_M, EARLY_M):
            panel.axhline(bound_m, color=hex_color(BAR_COLOR), linewidth=0.5)
        panel.set_yticks([0.01, 0.025, 0.1, 0.5, 1.0], ["1 cm", "2.5 cm", "10 cm", "50 cm", "1 m"])
        panel.minorticks_off()
    label_axes(panels, used, across, up)
    handles, labels = panels[0].get_legend_handles_labels()
    columns = min(len(labels), max(2, int(figure.get_figwidth() / LEGEND_ENTRY_IN)))
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, fontsize=9, frameon=False)
    figure.suptitle(title, fontsize=11, wrap=True)


def grid_of(count: int) -> tuple[int, int]:
    """Rows and columns for a number of panels, up to three in a row."""
    columns = min(3, count)
    return -(-count // columns), columns


def save_figure(figure: "Figure", folder: Path, name: str) -> Path:
    """Write a figure as NAME.svg and return the path."""
    import matplotlib as mpl

    path = folder / f"{name}.svg"
    with mpl.rc_context({"svg.hashsalt": name}):
        figure.savefig(path, metadata={"Date": None, "Creator": None})
    return path
