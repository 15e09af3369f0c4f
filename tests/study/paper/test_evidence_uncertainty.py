"""The simulation's own uncertainty beside the deviations of a study."""

from dataclasses import replace
from pathlib import Path

import pytest

from hexctl.backends.sim.world import World, load_world
from hexctl.control.assessment.uncertainty_store import known_uncertainty
from hexctl.study.paper.evidence import StudyUncertainty, cm
from hexctl.study.paper.searches import Findings
from tests.robots import shipped
from tests.study.made_up import made_up_findings, reported, spread_out, summarised


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def findings_of(**options: float) -> Findings:
    return made_up_findings(
        spread_out(0.5), {2: 0.5}, legs=(2,), optimizers=("random",), runs=2, budget=20, **options
    )


def test_what_is_known_stands_beside_deviations_with_what_it_means() -> None:
    known = known_uncertainty("ant")
    assert known is not None
    study = StudyUncertainty.of(shipped(), World(), 30.0)
    assert study.beside(0.006) == f"{cm(0.006)} ± {cm(known.numerical_m)}"
    assert study.as_json() == known.to_dict()
    assert study.lines == [study.sentence]
    assert f"2.8 times this, {cm(2.8 * known.numerical_m)}, cannot be told apart" in study.sentence
    assert "measured" not in study.sentence
    limp = StudyUncertainty.of(shipped(), load_world("slope"), 30.0, failure="limp")
    assert "; measured with locked legs on the flat world)" in limp.sentence


def test_what_is_not_known_is_said_once_and_not_of_short_walks() -> None:
    long, short = (StudyUncertainty.of(shipped(), World(), duration_s) for duration_s in (45.0, 5.0))
    assert long.beside(0.006) == cm(0.006)
    assert long.as_json() is None
    assert "hexctl check ROBOT --physics" in long.sentence
    assert long.lines == [long.sentence]
    assert short.lines == []


@pytest.mark.slow
def test_report_and_summary_have_it() -> None:
    findings = findings_of()
    study = StudyUncertainty.of(findings.plan.robot, findings.plan.world, 30.0)
    assert findings.plan.duration_s == 30.0
    page = reported(findings, Path()).read_text(encoding="utf-8")
    assert study.sentence.replace("'", "&#39;") in page
    best_m = min(landscape.best_m for landscape in findings.landscapes.values())
    assert f"<td>{study.beside(best_m)}</td>" in page
    assert summarised(findings)["uncertainty"] == study.as_json()
    slow = replace(findings, plan=replace(findings.plan, duration_s=45.0))
    assert summarised(slow)["uncertainty"] is None
