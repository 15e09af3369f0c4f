"""Make the figure of docs/explanation/priors.md: what is believed of all gaits before, and after some trials.

    .venv/bin/python docs/make_prior_figure.py OUT.png

Simulates one world that no prior knows, all 120 gaits: about half a minute on two cores.
"""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hexctl.adapt.optimizer import NINETY_PERCENT
from hexctl.adapt.optimizers.bayes import Bayes
from hexctl.adapt.prior.prior import load_prior
from hexctl.adapt.prior.prior_files import shipped_priors
from hexctl.adapt.prior.samples import samples_of
from hexctl.backends.sim.world import load_world
from hexctl.control.assessment.score import progress_floor_m
from hexctl.palette import BEST_COLOR, LINE_COLOR, hex_color
from hexctl.robot.loader import load_robot
from hexctl.study.figure_style import label_axes, new_figure
from hexctl.study.landscape import Landscape, LandscapeSpec
from hexctl.study.transfer.transfer_searches import walk_of
from hexctl.study.walk_cache import WalkCache
from hexctl.study.walking import evaluate

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WORLD, LEG = "transfer:2", 5

#: After so many trials the belief is drawn.
AFTER = (0, 1, 6)


def walked() -> Landscape:
    """Return what really becomes of every gait in the world of the figure."""
    robot = load_robot("ant")
    spec = LandscapeSpec(
        robot=robot, world=load_world(WORLD), leg=LEG, self_rotation="rear", seed=2, place=WORLD
    )
    return evaluate([spec], WalkCache())[0]


def draw(panel: "Axes", search: Bayes, truth: Landscape, order: np.ndarray, tried: list[int]) -> None:
    """Draw belief and truth of all gaits; the belief is the search's own."""
    forecast = search.forecast()
    mean_m, sd_m = forecast.mean_m[order], forecast.sd_m[order]
    places = np.arange(1, len(order) + 1)
    reach_m = NINETY_PERCENT * sd_m
    panel.fill_between(places, mean_m - reach_m, mean_m + reach_m, color="#56B4E9", alpha=0.35, lw=0)
    panel.plot(places, mean_m, color="#0072B2", linewidth=1.2, label="believed, and 9 of 10 in the band")
    panel.plot(places, truth.number("signed_m")[order], ".", color="#222222", markersize=3.5, label="true")
    rows = [int(np.flatnonzero(order == code - 1)[0]) for code in tried]
    panel.plot(
        np.array(rows) + 1,
        truth.number("signed_m")[order][rows],
        "o",
        color=hex_color(BEST_COLOR),
        markersize=8,
        fillstyle="none",
        markeredgewidth=1.8,
        label="walked",
    )
    panel.axhline(0, color=hex_color(LINE_COLOR), linewidth=0.6)
    titles = {0: "before the first trial", 1: "after one trial"}
    panel.set_title(titles.get(len(tried), f"after {len(tried)} trials"), fontsize=10)
    panel.set_ylim(-2.2, 2.2)


def main(path: Path) -> None:
    """Write the figure."""
    robot, truth = load_robot("ant"), walked()
    prior = load_prior(next(shipped_priors().glob("ant-locked-rear-30s.npz")))
    search = Bayes(
        truth.spec.space,
        0,
        samples=samples_of(prior, robot, LEG),
        target_m=0.025,
        duration_s=truth.spec.duration_s,
        floor_m=progress_floor_m(robot, truth.spec.trial(1).plan, truth.spec.duration_s),
    )
    order = np.argsort(search.forecast().mean_m)
    figure, panels = new_figure(1, len(AFTER), (12.0, 4.0))
    tried: list[int] = []
    for panel, trials in zip(panels, AFTER, strict=True):
        while len(tried) < trials:
            (code,) = search.ask(1)
            search.tell([code], [float(truth.scores[code - 1])], [walk_of(truth, code)])
            tried.append(code)
        draw(panel, search, truth, order, tried)
    label_axes(panels, len(AFTER), "the 120 gaits, by what is believed at first", "end off the line, m")
    handles, labels = panels[-1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=9, frameon=False)
    figure.savefig(path, dpi=120, metadata={"Software": None})


if __name__ == "__main__":
    main(Path(sys.argv[1]))
