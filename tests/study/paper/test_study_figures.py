"""Colours of the figures."""

import numpy as np
import pytest

from hexctl.palette import INVALID_COLOR, deviation_color
from hexctl.study.paper.study_figures import trajectories_figure
from tests.study.made_up import made_up


def test_a_path_has_the_colour_that_the_viewer_gives_its_deviation() -> None:
    pytest.importorskip("matplotlib", reason="figures need the study extra")
    signed_m = np.full(120, 0.5)
    signed_m[:6] = [0.001, -0.03, 0.1, -0.2, 0.9, 5.0]
    figure = trajectories_figure([made_up(5, "rear", signed_m, invalid=[20])], "paths")
    grey, lines = figure.axes[0].collections[:2]
    (invalid,) = np.asarray(grey.get_edgecolor())
    np.testing.assert_allclose(invalid[:3], np.array(INVALID_COLOR) / 255, atol=1e-3)
    lines.update_scalarmappable()
    deviations_m = np.asarray(lines.get_array())
    assert {0.001, 5.0} <= set(deviations_m.round(6).tolist())
    for deviation_m, drawn in zip(deviations_m, np.asarray(lines.get_edgecolor()), strict=True):
        color = np.array(deviation_color(float(deviation_m), valid=True)) / 255
        np.testing.assert_allclose(drawn[:3], color, atol=0.02)
