"""Walks with the gaits that a robot would use anyway, beside the landscapes of a study."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hexctl.study.reports.figures import convergence_figure
from hexctl.study.searches import DefaultWalk
from hexctl.study.verdicts.claim_evidence import cm
from tests.study.made_up import made_up_findings, reported, spread_out, summarised

WALKS = (
    DefaultWalk(leg=2, gait="demo", status="ok", signed_m=-0.35, distance_m=4.0),
    DefaultWalk(leg=2, gait="tripod", status="ok", signed_m=0.001, distance_m=4.1),
    DefaultWalk(leg=6, gait="demo", status="fell", signed_m=None, distance_m=None),
    DefaultWalk(leg=6, gait="tripod", status="no_progress", signed_m=0.2, distance_m=1.0),
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

    panel, other = convergence_figure(findings, paper_count=True).axes[:2]
    levels = {str(line.get_label()): np.asarray(line.get_ydata()) for line in panel.get_lines()}
    assert (levels["demo, without a search"] == 0.35).all()
    assert (levels["tripod, without a search"] == 0.001).all()
    assert f"demo {cm(0.35)}, tripod {cm(0.001)} (below the scale)" in panel.get_title()
    assert "demo fell, tripod no_progress" in other.get_title()

    (demo, *_, stopped) = summarised(findings)["default_gaits"]
    assert (demo["leg"], demo["gait"], demo["signed_m"], demo["final_m"]) == (2, "demo", -0.35, 0.35)
    assert (stopped["status"], stopped["signed_m"], stopped["final_m"]) == ("no_progress", 0.2, None)
