"""Walks with the gaits that a robot would use anyway, beside the landscapes of a study."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hexctl.control.batch import run_sim_trial
from hexctl.study import default_gaits
from hexctl.study.default_gaits import DefaultWalk, default_trial, walk_default_gaits
from hexctl.study.landscapes.cache import CacheError, LandscapeCache
from hexctl.study.reports.figures import convergence_figure
from hexctl.study.study_plan import StudyPlan
from hexctl.study.verdicts.claim_evidence import cm
from tests.robots import shipped
from tests.study.made_up import made_up_findings, reported, spread_out, summarised
from tests.trials import gait_of

PLAN = StudyPlan(robot=shipped(), legs=(2, 5), failure="limp", duration_s=0.2)


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the walks of the plan."""
    folder = tmp_path_factory.mktemp("walked")
    walk_default_gaits(PLAN, LandscapeCache(folder), jobs=1)
    return folder


def test_each_leg_walks_the_default_gait_and_the_tripod_as_a_trial_would(tmp_path: Path) -> None:
    legs: list[None] = []
    walks = walk_default_gaits(PLAN, LandscapeCache(tmp_path), jobs=1, on_leg=lambda: legs.append(None))
    assert [(walk.leg, walk.gait) for walk in walks] == [
        (leg, gait) for leg in (2, 5) for gait in ("demo", "tripod")
    ]
    assert len(legs) == 2
    spec = PLAN.searched_specs()[1]
    trial = default_trial(spec, "tripod")
    assert trial.plan.gait == gait_of(PLAN.robot, "tripod")
    assert trial == replace(spec.trial(1), plan=replace(spec.trial(1).plan, gait=trial.plan.gait))
    alone = run_sim_trial(trial)
    assert (walks[-1].status, walks[-1].distance_m) == (alone.status, alone.distance_m)
    assert alone.deviation is not None
    assert walks[-1].signed_m == alone.deviation.signed


def test_walks_are_simulated_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache = LandscapeCache(tmp_path)
    walks = walk_default_gaits(PLAN, cache, jobs=1)
    monkeypatch.setattr(default_gaits, "run_sim_trials", None)
    assert walk_default_gaits(PLAN, LandscapeCache(tmp_path)) == walks
    with pytest.raises(TypeError):
        walk_default_gaits(replace(PLAN, failure="locked"), cache)


@pytest.mark.parametrize(
    "content", ["", "[]", "{}", '[{"leg": 2}]', "[1, 2]", "null", '[{"leg": 9, "gait": "demo"}]']
)
def test_a_damaged_file_is_named_and_walked_again(content: str, walked: Path, tmp_path: Path) -> None:
    shutil.copytree(walked, tmp_path, dirs_exist_ok=True)
    cache = LandscapeCache(tmp_path)
    walks = walk_default_gaits(PLAN, cache, jobs=1)
    (damaged, _) = sorted(tmp_path.glob("*.default.json"))
    damaged.write_text(content, encoding="utf-8")
    assert walk_default_gaits(PLAN, cache, jobs=1) == walks
    (note,) = cache.notes
    assert damaged.name in note


def test_a_disk_that_refuses_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(default_gaits, "atomic_write", refuse)
    with pytest.raises(CacheError, match="No space left"):
        walk_default_gaits(PLAN, LandscapeCache(tmp_path), jobs=1)


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
