"""The report of a study: its page, figures and tables."""

import re
from pathlib import Path

import numpy as np
import pytest

from hexctl.palette import INVALID_COLOR, deviation_color
from hexctl.study.experiment import where
from hexctl.study.paper.searches import Findings, curve_of
from hexctl.study.paper.study_figures import trajectories_figure
from hexctl.study.report_page import Block, Bullets, Picture, Section, Table, render_page
from tests.study.made_up import made_up, made_up_findings, reported, spread_out

HOSTILE = '<script>alert("a & b")</script>'


def test_every_text_is_escaped(tmp_path: Path) -> None:
    image = tmp_path / "a<b.svg"
    image.write_bytes(b"svg")
    blocks: list[Block] = [
        HOSTILE,
        Bullets([HOSTILE]),
        Table([HOSTILE], [[HOSTILE]]),
        Picture(image, HOSTILE, HOSTILE),
    ]
    text = render_page(HOSTILE, [Section(HOSTILE, blocks)])
    assert text.count("<script") == 1
    assert HOSTILE not in text
    assert text.count("&lt;script&gt;") >= 9
    assert "a<b" not in text


def test_verdicts_are_coloured_and_nothing_else_is() -> None:
    row = ["holds", "does not hold, by 2 cm", "not measured", "not judged: too short", "it holds", ""]
    text = render_page("", [Section("", [Table(["holds"] * 6, [row])])])
    assert '<td class="yes">holds</td>' in text
    assert '<td class="no">does not hold, by 2 cm</td>' in text
    assert '<td class="open">not judged: too short</td>' in text
    assert text.count('<td class="') == 3


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


@pytest.fixture(scope="module")
def findings() -> Findings:
    left = {2: 0.5, 6: 0.0}
    return made_up_findings(
        spread_out(0.5), left, legs=(2, 6), optimizers=("pso", "random"), runs=3, budget=25
    )


@pytest.fixture(scope="module")
def folder(findings: Findings, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study")
    reported(findings, folder)
    return folder


@pytest.mark.slow
def test_the_page_asks_nobody_for_anything(folder: Path) -> None:
    text = re.sub(r'"data:[^"]*"', '""', (folder / "report.html").read_text(encoding="utf-8"))
    assert not re.search(
        r"https?:|//|<script [^>]*src|<link|<iframe|@import|url\(", text, flags=re.IGNORECASE
    )
    assert set(re.findall(r'src="([^"]*)"', text)) == {""}


@pytest.mark.slow
def test_tables_hold_every_gait_evaluation_and_run(findings: Findings, folder: Path) -> None:
    import pyarrow.parquet as pq

    gaits, curves, runs = (
        pq.read_table(folder / f"{name}.parquet").to_pydict()
        for name in ("landscapes", "convergence", "runs")
    )
    assert len(gaits["code"]) == 2 * 2 * 120
    assert len(curves["mean_m"]) == 2 * 2 * 25
    assert len(runs["best_m"]) == 2 * 2 * 3 * 25
    landscape = findings.without(2)
    assert gaits["signed_m"][:120] == landscape.number("signed_m").tolist()
    assert gaits["path_deviation_m"][7] == landscape.paths_m[7, :, 1].tolist()
    searches = where(findings.first_runs, leg=2, optimizer="pso")
    assert curves["mean_m"][:25] == curve_of(searches)["mean_m"].tolist()
    assert np.array_equal(np.reshape(runs["code"][: 3 * 25], (3, 25)), np.stack(searches["codes"]))
