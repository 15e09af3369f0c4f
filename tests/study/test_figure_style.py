"""Lines of the figures: the colours and dashes of the palette."""

import pytest

from hexctl.palette import OPTIMIZER_COLORS, OTHER_OPTIMIZER_COLORS, hex_color
from hexctl.study.figure_style import line_of
from hexctl.study.paper.study_figures import means_figure
from tests.study.made_up import made_up_findings, spread_out


def test_each_optimizer_has_a_line_of_its_own() -> None:
    looks = {name: str(line_of(name)) for name in OPTIMIZER_COLORS}
    assert len(set(looks.values())) == len(looks)
    assert line_of("pso") == {"color": "#0072b2", "linestyle": "-"}
    assert line_of("psosp") == {"color": "#0072b2", "linestyle": (0, (3.7, 1.6))}
    mine = line_of("mine:Search")
    assert mine == line_of("mine:Search")
    assert mine["color"] in map(hex_color, OTHER_OPTIMIZER_COLORS)
    assert str(mine) not in looks.values()


def test_curves_are_drawn_in_their_lines() -> None:
    pytest.importorskip("matplotlib", reason="figures need the study extra")
    names = ("pso", "psosp", "random")
    findings = made_up_findings(spread_out(1.0), legs=(1,), optimizers=names, runs=2, budget=6)
    drawn = {str(line.get_label()): line for line in means_figure(findings).axes[0].lines}
    assert [drawn[name].get_color() for name in names] == ["#0072b2", "#0072b2", "#000000"]
    assert [drawn[name].is_dashed() for name in names] == [False, True, True]
