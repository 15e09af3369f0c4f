"""The library calls behind `hexctl study`: they return results, report progress and print nothing."""

import json
from pathlib import Path

import pytest

from hexctl.backends.sim.world import World
from hexctl.control.assessment.uncertainty_store import SimulationUncertainty, keep_uncertainty
from hexctl.errors import InputError
from hexctl.study.paper.study_plan import StudyPlan
from hexctl.study.walk_cache import WalkCache
from tests.robots import shipped
from tests.study.made_up_transfer import plan as transfer_plan
from tests.study.watching import Remembering

pytestmark = pytest.mark.slow


def plan(duration_s: float = 0.2) -> StudyPlan:
    return StudyPlan(
        robot=shipped(), legs=(2,), optimizers=("pso", "random"), runs=2, budget=3, duration_s=duration_s
    )


def test_a_study_from_python(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, cache, progress = tmp_path / "out", WalkCache(tmp_path / "cache"), Remembering()
    result = plan().run(folder=folder, cache=cache, jobs=1, progress=progress)
    assert capsys.readouterr() == ("", "")
    assert result.report == folder / "report.html"
    assert result.found.plan.legs == (2,)
    assert json.loads((folder / "study.json").read_text()) == json.loads(json.dumps(result.to_json()))
    assert progress.walks == 240
    assert progress.steps == sum(steps for _, steps in progress.stages)
    assert cache.count(plan().walked()) == (240, 240)

    again = Remembering()
    plan().run(folder=folder, cache=cache, progress=again)
    assert again.walks == 0


def test_the_uncertainty_measured_beside_the_cache_is_that_of_the_study(tmp_path: Path) -> None:
    cache = WalkCache(tmp_path / "runs" / "study-cache")
    found = SimulationUncertainty(step_m=0.3, solver_m=0.4, contact_m=1.0, walks=20, duration_s=0.2)
    keep_uncertainty(shipped(), World(), found, folder=tmp_path / "runs")
    result = plan().run(folder=tmp_path / "out", cache=cache, jobs=1)
    assert result.found.uncertainty.known == found
    assert result.to_json()["uncertainty"]["numerical_m"] == 0.3
    assert "± 30.0 cm" in result.report.read_text(encoding="utf-8")
    assert [claim["verdict"] for claim in result.to_json()["claims"]] == [
        claim.verdict for claim in result.found.claims
    ]


def test_a_damaged_file_of_measurements_is_refused_before_anything_is_walked(tmp_path: Path) -> None:
    (tmp_path / "uncertainty.yaml").write_text("measured: 3", encoding="utf-8")
    progress = Remembering()
    with pytest.raises(InputError, match=r"uncertainty\.yaml"):
        plan().run(folder=tmp_path / "out", cache=WalkCache(tmp_path / "cache"), progress=progress)
    assert progress.walks == 0


def test_an_interrupted_study_keeps_its_gaits_and_leaves_no_empty_folder(tmp_path: Path) -> None:
    cache = WalkCache(tmp_path / "cache")
    with pytest.raises(KeyboardInterrupt):
        plan().run(folder=tmp_path / "out", cache=cache, jobs=1, progress=Remembering(interrupt_after=40))
    assert cache.count(plan().walked()) == (40, 240)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("jobs", "duration_s"), [(0, 0.2), (1025, 0.2), (1, -1.0)])
def test_what_cannot_be_done_is_refused_before_anything_runs(
    jobs: int, duration_s: float, tmp_path: Path
) -> None:
    cache = WalkCache(tmp_path / "cache")
    with pytest.raises(InputError):
        plan(duration_s).run(folder=tmp_path / "out", cache=cache, jobs=jobs)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_with_other_things_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(InputError, match="holds other things"):
        transfer_plan().run(folder=tmp_path, cache=WalkCache(tmp_path / "cache"))
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]
