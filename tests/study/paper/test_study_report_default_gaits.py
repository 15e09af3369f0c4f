"""Walks with the gaits that a robot would use anyway, beside the landscapes of a study."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pandas import DataFrame

from hexctl.study.paper.evidence import cm
from hexctl.study.paper.searches import PAPER
from hexctl.study.paper.study_figures import convergence_figure
from tests.study.made_up import made_up_findings, reported, spread_out, summarised

pytestmark = pytest.mark.slow

NAN = float("nan")

WALKS = DataFrame(
    [
        (2, "demo", "ok", -0.35, 4.0, 0.35),
        (2, "tripod", "ok", 0.001, 4.1, 0.001),
        (6, "demo", "fell", NAN, NAN, NAN),
        (6, "tripod", "no_progress", 0.2, 1.0, NAN),
    ],
    columns=["leg", "gait", "status", "signed_m", "distance_m", "final_m"],
)


def test_the_report_has_them_beside_the_searches(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="figures need the study extra")
    findings = made_up_findings(
        spread_out(0.5), {2: 0.5, 6: 0.0}, legs=(2, 6), optimizers=("pso", "random"), runs=3, budget=25
    )
    assert "Without a search" not in reported(findings, tmp_path).read_text(encoding="utf-8")
    findings = replace(findings, default_walks=WALKS)
    text = reported(findings, tmp_path).read_text(encoding="utf-8")
    section = text[text.index(">Without a search</h") :]
    section = section[: section.index("</table>")]
    cells = (cm(0.35), cm(0.001), "fell", "no_progress", "random after 20", "median of all valid gaits")
    for cell in cells:
        assert f">{cell}<" in section, cell
    median_m = np.median(np.abs(findings.rotated(2).number("signed_m")))
    assert f">{cm(float(median_m))}<" in section

    panel, other = convergence_figure(findings, PAPER).axes[:2]
    levels = {str(line.get_label()): np.asarray(line.get_ydata()) for line in panel.get_lines()}
    assert (levels["demo, without a search"] == 0.35).all()
    assert (levels["tripod, without a search"] == 0.001).all()
    assert f"demo {cm(0.35)}, tripod {cm(0.001)} (below the scale)" in panel.get_title()
    assert "demo fell, tripod no_progress" in other.get_title()

    (demo, *_, stopped) = summarised(findings)["default_gaits"]
    assert (demo["leg"], demo["gait"], demo["signed_m"], demo["final_m"]) == (2, "demo", -0.35, 0.35)
    assert (stopped["status"], stopped["signed_m"], stopped["final_m"]) == ("no_progress", 0.2, None)
