import base64
import json
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pyarrow.parquet as pq
import pytest

from hexctl.study.frames import where
from hexctl.study.paper.searches import FRESH, Findings, curve_of
from hexctl.study.report_page import texts
from tests.study.made_up import made_up, made_up_findings, reported, spread_out, summarised

pytestmark = pytest.mark.slow


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


def test_the_page_holds_all_figures_itself(folder: Path) -> None:
    text = (folder / "report.html").read_text(encoding="utf-8")
    images = re.findall(r'src="data:image/svg\+xml;base64,([^"]+)"', text)
    assert len(images) == len(texts("captions"))
    assert [base64.b64decode(image) for image in images] == [
        (folder / f"{name}.svg").read_bytes() for name in texts("captions")
    ]


def test_the_page_asks_nobody_for_anything(folder: Path) -> None:
    text = re.sub(r'"data:[^"]*"', '""', (folder / "report.html").read_text(encoding="utf-8"))
    assert not re.search(
        r"https?:|//|<script [^>]*src|<link|<iframe|@import|url\(", text, flags=re.IGNORECASE
    )
    assert set(re.findall(r'src="([^"]*)"', text)) == {""}


def test_the_page_is_well_formed(folder: Path) -> None:
    text = (folder / "report.html").read_text(encoding="utf-8")
    body = re.sub(r"<(meta|img)([^>]*)>", r"<\1\2/>", text[text.index("<html") :])
    ElementTree.fromstring(body)  # noqa: S314  our own text


def test_the_page_says_what_holds_and_how_to_read_it(folder: Path) -> None:
    text = (folder / "report.html").read_text(encoding="utf-8")
    for words in (
        "does not hold",
        ">holds<",
        "not measured",
        "reconstruction",
        "Assumptions",
        "no evidence: also holds on random numbers",
        "random untried codes",
        "121/",
    ):
        assert words in text


def test_every_figure_is_there_as_svg(folder: Path) -> None:
    for name in texts("captions"):
        assert ElementTree.parse(folder / f"{name}.svg").getroot().tag.endswith("svg")  # noqa: S314


def test_tables_hold_every_gait_evaluation_and_run(findings: Findings, folder: Path) -> None:
    gaits, curves, runs = (
        pq.read_table(folder / f"{name}.parquet").to_pydict()
        for name in ("landscapes", "convergence", "runs")
    )
    assert len(gaits["code"]) == 2 * 2 * 120
    assert len(curves["mean_m"]) == 2 * 2 * 2 * 25
    assert len(runs["best_m"]) == 2 * 2 * 2 * 3 * 25
    landscape = findings.without(2)
    assert gaits["signed_m"][:120] == landscape.number("signed_m").tolist()
    assert gaits["path_deviation_m"][7] == landscape.paths_m[7, :, 1].tolist()
    searches = where(findings.first_runs, leg=2, optimizer="pso", count=FRESH)
    assert curves["mean_m"][:25] == curve_of(searches)["mean_m"].tolist()
    assert np.array_equal(np.reshape(runs["code"][: 3 * 25], (3, 25)), np.stack(searches["codes"]))


def test_the_summary_is_plain_json(findings: Findings) -> None:
    text = json.dumps(summarised(findings), allow_nan=False)
    assert len(json.loads(text)["claims"]) == 12


def test_a_study_without_valid_gaits_still_reports(tmp_path: Path) -> None:
    from hexctl.study.paper.searches import search_all

    plan = made_up_findings(spread_out(1.0), legs=(2,), optimizers=("pso",), runs=2, budget=20).plan
    nothing = [made_up(2, rotation, spread_out(1.0), invalid=range(1, 121)) for rotation in ("none", "rear")]
    findings = search_all(plan, nothing)
    assert reported(findings, tmp_path).exists()
    json.dumps(summarised(findings), allow_nan=False)


def test_a_short_study_reports_that_it_judges_nothing(tmp_path: Path) -> None:
    findings = made_up_findings(
        spread_out(0.5), {2: 0.5}, legs=(2,), optimizers=("pso",), runs=2, budget=20, duration_s=0.5
    )
    text = reported(findings, tmp_path).read_text(encoding="utf-8")
    assert "not judged: walks of 0.5 s, needs at least 30 s" in text
    assert not re.search(r'class="(yes|no)"', text)
    outcome = json.loads(json.dumps(summarised(findings), allow_nan=False))
    assert (
        {claim["holds"] for claim in outcome["claims"]} == {bar["holds"] for bar in outcome["bars"]} == {None}
    )


def test_contents_lead_to_every_section(folder: Path) -> None:
    text = (folder / "report.html").read_text(encoding="utf-8")
    targets = re.findall(r'<h2 id="([^"]+)"', text)
    assert targets == re.findall(r'<a href="#([^"]+)"', text)
    assert len(set(targets)) == len(targets) > 0


def test_the_summary_stands_first_and_the_world_in_a_fold(folder: Path) -> None:
    text = (folder / "report.html").read_text(encoding="utf-8")
    assert (
        text.index("paper's 12 claims".replace("'", "&#39;")) < text.index("<details>") < text.index("<nav")
    )
    assert "friction_cone" in text[text.index("<details>") : text.index("</details>")]
