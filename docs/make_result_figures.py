"""Make the figures of docs/results/results.yaml: how straight walks are, and how quick searches.

    .venv/bin/python docs/make_result_figures.py [FOLDER]

Writes holds.svg and search.svg, to docs/images without FOLDER. A second.
"""

import sys
from pathlib import Path

import matplotlib as mpl
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

sys.path.insert(0, str(Path(__file__).parents[1]))
from benchmarks.results import figure as number
from benchmarks.results import results
from hexctl.palette import BEST_COLOR, hex_color
from pictures.picture import INK, READABLE, save_svg

IMAGES = Path(__file__).parent / "images"

#: Rows of the table `line`, their labels and colours.
HOLDS = (
    ("open_loop", "open loop", "#999999"),
    ("yaw", "yaw, no contacts", "#E69F00"),
    ("pose", "position and yaw", "#0072B2"),
)

#: Ticks of a distance from the line, in cm.
DISTANCES_CM = {0.1: "1 mm", 1: "1 cm", 10: "10 cm", 100: "1 m"}


def holds() -> Figure:
    """Return the distance from the line by what is held: mean and 90th percentile."""
    tables, figure = results(), Figure(figsize=(9.0, 3.0), layout="constrained")
    ax = figure.subplots()
    for place, (row, _, color) in enumerate(reversed(HOLDS)):
        mean, p90 = (float(number(tables, f"line.{row}.{column}")) for column in ("mean", "p90"))
        ax.plot([mean, p90], [place, place], color=color, linewidth=5)
        ax.plot(mean, place, "o", color=color, markersize=16)
        ax.plot(p90, place, "|", color=color, markersize=18, markeredgewidth=5)
        ax.annotate(f"{mean:g} cm", (p90, place), (10, 0), textcoords="offset points", va="center")
    ax.set_xscale("log")
    _scale(ax.xaxis, DISTANCES_CM)
    ax.set_xlim(0.1, 1000)
    ax.set_ylim(-0.5, len(HOLDS) - 0.5)
    ax.set_yticks(range(len(HOLDS)), [label for _, label, _ in reversed(HOLDS)], fontsize=13)
    ax.set_xlabel("distance from the line after 30 s (dot: mean, bar: 90th percentile)")
    return figure


def search() -> Figure:
    """Return the mean distance of the best gait so far over trials."""
    tables, figure = results(), Figure(figsize=(9.0, 4.2), layout="constrained")
    ax, columns = figure.subplots(), tables["priors"]["columns"]
    trials = [int(key[1:]) for key in columns]
    for name, color in (("random", INK), ("bayes", hex_color(BEST_COLOR))):
        means = [float(number(tables, f"priors.{name}.{key}")) for key in columns]
        ax.plot(trials, means, marker="o", color=color)
        ax.annotate(name, (trials[4], means[4]), (6, 6), textcoords="offset points", color=color, fontsize=14)
    ax.set_yscale("log")
    ax.set_xscale("log")
    _scale(ax.yaxis, {2.5: "2.5 cm", 10: "10 cm", 50: "50 cm", 100: "1 m"})
    _scale(ax.xaxis, {trial: f"{trial}" for trial in trials})
    ax.set_xlabel("trials walked")
    ax.set_ylabel("best gait so far ends off the line, mean")
    return figure


def _scale(axis: Axis, ticks: dict[float, str]) -> None:
    axis.set_ticks(list(ticks), list(ticks.values()))
    axis.set_minor_locator(NullLocator())


def main(folder: Path) -> None:
    """Write the figures."""
    with mpl.rc_context(READABLE):
        for draw in (holds, search):
            save_svg(draw(), folder / f"{draw.__name__}.svg")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES)
