"""The figure of the documentation: how long robots moved on after each fault, every injection a point."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from faults.backend import BACKENDS
from faults.fault import FAULTS
from faults.measurement import REST_S, Outcome
from faults.table import MOVING

#: Colours by backend, readable on white and on dark, and by colour-blind people (Okabe and Ito).
COLORS = (
    *("#999999", "#0072B2", "#56B4E9", "#009E73", "#D55E00", "#CC79A7", "#B8860B", "#8C564B"),
    *("#6B4FA0", "#2F9E9E", "#C44E52"),
)

#: Colour of text and lines that is readable on white and on dark.
NEUTRAL = "#7a8290"

#: Pixels per inch of a PNG file.
DPI = 130

#: Times beyond this are drawn at the edge.
MOST_S = 1.6


def draw(outcomes: Iterable[Outcome], path: Path) -> None:
    """Draw the times to rest into a file, whose ending says its format; transparent, for any background."""
    from matplotlib.figure import Figure

    shown = [one for one in outcomes if one.punctual and one.safe == "rests" and one.phase in MOVING]
    names = [name for name in FAULTS if any(one.fault == name for one in shown)]
    figure = Figure(figsize=(9.0, 0.9 + 0.5 * len(names)), layout="constrained")
    figure.patch.set_alpha(0.0)
    panel = figure.subplots()
    panel.patch.set_alpha(0.0)
    chance = np.random.default_rng(0)
    for number, (backend, color) in enumerate(zip(BACKENDS, COLORS, strict=True)):
        rows = [one for one in shown if one.backend == backend]
        if not rows:
            continue
        times_s = [MOST_S if one.rest_s is None else min(one.rest_s, MOST_S) for one in rows]
        heights = [names.index(one.fault) + (number - len(BACKENDS) / 2) * 0.065 for one in rows]
        heights = list(np.array(heights) + chance.uniform(-0.03, 0.03, len(rows)))
        panel.plot(times_s, heights, "o", color=color, markersize=3.5, alpha=0.7, mew=0, label=backend)
    panel.axvline(REST_S, color=NEUTRAL, linewidth=1.0, linestyle="--")
    panel.set_yticks(range(len(names)), [FAULTS[name].words for name in names])
    panel.invert_yaxis()
    panel.set_xlabel("from the fault until the robot is at rest, s", color=NEUTRAL)
    panel.tick_params(colors=NEUTRAL)
    for spine in panel.spines.values():
        spine.set_color(NEUTRAL)
    panel.grid(visible=True, axis="x", linewidth=0.3, color=NEUTRAL)
    legend = figure.legend(loc="outside lower center", ncols=4, fontsize=9, frameon=False)
    for text in legend.get_texts():
        text.set_color(NEUTRAL)
    figure.savefig(path, dpi=DPI, metadata={"Software": None} if path.suffix == ".png" else None)
