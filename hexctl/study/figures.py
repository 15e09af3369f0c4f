"""All figures of a study, drawn one after the other."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hexctl.study.curve_figures import convergence_figure, means_figure
from hexctl.study.drawing import save_figure
from hexctl.study.findings import Findings
from hexctl.study.path_figures import best_figure, examples_figure, trajectories_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, kw_only=True)
class FigureEntry:
    """One figure of the report.

    Attributes:
        name: of its files, without the ending.
        paper: what the paper shows and says there.
        here: how to read it.
        draw: draws it; None where the study has nothing to show.
    """

    name: str
    paper: str
    here: str
    draw: "Callable[[Findings], Figure | None]"


FIGURES = (
    FigureEntry(
        name="trajectories_without_self_rotation",
        paper="Fig. 3: with leg 2 or 3 failed the robot goes left, with 5 or 6 right, with 1 or 4 straight "
        "or to either side.",
        here="All gaits of each leg; grey ones are invalid (they fell or made less than half the way).",
        draw=lambda findings: trajectories_figure(
            [findings.without(leg) for leg in findings.plan.legs], "All gaits, without self-rotation"
        ),
    ),
    FigureEntry(
        name="trajectories_with_self_rotation",
        paper="Fig. 6: after turning on the spot there are gaits with a small deviation for every leg.",
        here="The same gaits after the robot has turned until the failed leg trails.",
        draw=lambda findings: trajectories_figure(
            [findings.rotated(leg) for leg in findings.plan.legs], "All gaits, with self-rotation"
        ),
    ),
    FigureEntry(
        name="examples",
        paper="Fig. 4 and 9: legs 2 and 6 with an arbitrary gait, and with a gait that was found.",
        here="A dot every five seconds. The paper does not name its gaits; ours is code 57 on the left, the "
        "best of all gaits on the right.",
        draw=examples_figure,
    ),
    FigureEntry(
        name="convergence_paper_count",
        paper="Fig. 7: curves fall within 20 evaluations, are flat after, and end around 2.5 cm.",
        here="A repeated code costs an evaluation, as in the paper. A run without a valid gait so far is "
        "left out of the mean. The scale is logarithmic. The spread of every optimizer is in "
        "convergence.parquet.",
        draw=lambda findings: convergence_figure(findings, paper_count=True),
    ),
    FigureEntry(
        name="convergence_fresh_count",
        paper="Not in the paper: hexctl walks no gait twice, so a search does not pay for repetitions.",
        here="A dot marks where a search has, on average, asked for its last code of its own; random untried "
        "codes go on from there. After 120 evaluations every gait is known.",
        draw=lambda findings: convergence_figure(findings, paper_count=False),
    ),
    FigureEntry(
        name="convergence_means",
        paper="Abstract: 10 cm with 20 evaluations, 2.5 cm with 40 to 60, on average.",
        here="All legs and runs together. Triangles: 10 cm at 20 and 2.5 cm at 60 evaluations.",
        draw=means_figure,
    ),
    FigureEntry(
        name="best_trajectories",
        paper="Fig. 8: the best trajectories keep the direction reasonably well for each failed leg.",
        here="The best gait of each run, by the paper's count; the more runs found it, the thicker the line.",
        draw=best_figure,
    ),
)


def draw_figures(
    findings: Findings, folder: Path, on_figure: Callable[[str], None] = lambda _: None
) -> list[FigureEntry]:
    """Write all figures as PNG and SVG into a folder and return those that there are."""
    drawn = []
    for entry in FIGURES:
        figure = entry.draw(findings)
        if figure is not None:
            save_figure(figure, folder, entry.name)
            drawn.append(entry)
        on_figure(entry.name)
    return drawn
