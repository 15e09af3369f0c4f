"""Make the figure of docs/explanation/priors.md: what is believed of all gaits before, and after some trials.

    .venv/bin/python docs/make_prior_figure.py OUT.svg

Simulates one world that no prior knows, all 120 gaits: about half a minute on two cores.
"""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from hexctl.adapt.optimizer import NINETY_PERCENT
from hexctl.adapt.optimizers.bayes import Bayes
from hexctl.adapt.prior.prior import load_prior
from hexctl.adapt.prior.prior_files import shipped_priors
from hexctl.adapt.prior.samples import samples_of
from hexctl.backends.sim.world import load_world
from hexctl.control.scoring.score import progress_floor_m
from hexctl.palette import BEST_COLOR, LINE_COLOR, hex_color
from hexctl.robot.loader import load_robot
from hexctl.study.landscape import Landscape, LandscapeSpec
from hexctl.study.transfer.transfer_plan import walk_of
from hexctl.study.walk_cache import WalkCache
from hexctl.study.walking import Work

sys.path.insert(0, str(Path(__file__).parents[1]))
from pictures.picture import INK, READABLE, save_svg

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WORLD, LEG = "transfer:2", 5

#: After so many trials the belief is drawn.
AFTER = (0, 6)

#: Ends that are drawn, to either side in m.
SHOWN_M = 1.6


def walked() -> Landscape:
    """Return what really becomes of every gait in the world of the figure."""
    robot = load_robot("ant")
    spec = LandscapeSpec(
        robot=robot, world=load_world(WORLD), leg=LEG, self_rotation="rear", seed=2, place=WORLD
    )
    return Work(cache=WalkCache()).evaluate([spec])[0]


def draw(panel: "Axes", search: Bayes, truth: Landscape, tried: list[int]) -> None:
    """Draw belief and truth of all gaits; the belief is the search's own."""
    forecast = search.forecast()
    order = np.argsort(forecast.mean_m)
    mean_m, sd_m = forecast.mean_m[order], forecast.sd_m[order]
    places = np.arange(1, len(order) + 1)
    reach_m = NINETY_PERCENT * sd_m
    panel.fill_between(
        places, mean_m - reach_m, mean_m + reach_m, color="#56B4E9", alpha=0.35, lw=0, label="90 % interval"
    )
    panel.plot(places, mean_m, color="#0072B2", linewidth=2.5, label="expected")
    ends_m = truth.number("signed_m")[order]
    panel.plot(places, ends_m, ".", color=INK, markersize=5, label="true")
    rows = np.array([int(np.flatnonzero(order == code - 1)[0]) for code in tried], dtype=int)
    panel.plot(
        rows + 1,
        ends_m[rows],
        "o",
        color=hex_color(BEST_COLOR),
        markersize=9,
        fillstyle="none",
        markeredgewidth=2.2,
        label="walked",
    )
    panel.axhline(0, color=hex_color(LINE_COLOR), linewidth=1.0)
    panel.set_title(f"after {len(tried)} trials" if tried else "before the first trial")
    panel.set_ylim(-SHOWN_M, SHOWN_M)


def drawn() -> Figure:
    """Return belief and truth before and after some trials."""
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
    figure = Figure(figsize=(9.0, 4.6), layout="constrained")
    panels = figure.subplots(1, len(AFTER), sharey=True)
    tried: list[int] = []
    for panel, trials in zip(panels, AFTER, strict=True):
        while len(tried) < trials:
            (code,) = search.ask(1)
            search.tell([code], [float(truth.scores[code - 1])], [walk_of(truth, code)])
            tried.append(code)
        draw(panel, search, truth, tried)
        panel.set_xlabel("the 120 gaits, sorted by expectation")
    panels[0].set_ylabel("end left of the line, m")
    figure.legend(*panels[-1].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def main(path: Path) -> None:
    """Write the figure."""
    with mpl.rc_context(READABLE):
        save_svg(drawn(), path)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
