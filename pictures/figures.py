"""A walk in the viewer, and the paths of a search."""

from contextlib import chdir
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hexctl
from hexctl.adapt.sessions.walk_records import WalkRecord
from hexctl.cli.main import exit_code
from hexctl.palette import BEST_COLOR, LINE_COLOR, baseline_color, hex_color
from pictures.picture import INK, READABLE, Picture, save_svg
from pictures.window import BAR, SIZE, opened

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Gait of the walk, one of the 120, and the time of the picture: well into the walk.
GAIT, AT_S = "57", 17.3


def draw_walking(folder: Path) -> Picture:
    """Walk, record it into an empty folder, and return what the viewer shows."""
    path = folder / "walk.rrd"
    code = exit_code(["run", "--json", "--failed-leg", "5", "--gait", GAIT, "--record", str(path)])
    if code != 0:
        raise RuntimeError(f"hexctl run ended with {code}")
    with opened(path) as window:
        window.show_time(AT_S)
        return window.picture().cut(0, BAR, SIZE[0], SIZE[1] - BAR)


#: A world that no prior was built with, in which the search finds a straighter gait than all that need none.
WORLD, LEG, BUDGET = "transfer:5", 5, 20


def draw_session(folder: Path) -> Path:
    """Adapt, and draw the paths of all walks from above."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with chdir(folder):
        result = hexctl.adapt(LEG, world=WORLD, budget=BUDGET, record=False, progress=False)
    if result.best is None:
        raise RuntimeError("hexctl adapt found no gait")
    with mpl.rc_context(READABLE):
        figure = Figure(figsize=(9.0, 4.0), layout="constrained")
        ax = figure.subplots()
        ax.axhline(0.0, color=hex_color(LINE_COLOR), linewidth=1.5)
        for number, trial in enumerate(result.trials):
            _draw_path(ax, trial, "trials" if number == 0 else "", color=INK, linewidth=1.0, alpha=0.7)
        for walk in result.baseline:
            color = hex_color(baseline_color(walk.gait))
            _draw_path(ax, walk, f"{walk.gait}, without a search", color=color, linestyle="--")
        best = f"best, trial {result.best.index}"
        _draw_path(ax, result.best, best, color=hex_color(BEST_COLOR), linewidth=4)
        ax.set_xlabel("along the line, m")
        ax.set_ylabel("left of the line, m")
        ax.legend(loc="upper left", fontsize=11)
        return save_svg(figure, folder / "session.svg")


def _draw_path(ax: "Axes", walk: WalkRecord, label: str, **style: Any) -> None:
    path_m = walk.result.path_m
    ax.plot(path_m[:, 0], path_m[:, 1], label=label or None, **style)
