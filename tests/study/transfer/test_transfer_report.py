import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from hexctl.study.landscapes.landscape import Landscape
from hexctl.study.transfer.transfer_report import (
    REPORT,
    TABLE,
    transfer_bars,
    transfer_json,
    write_transfer_report,
)
from hexctl.study.transfer.transfer_searches import TransferFindings, search_worlds
from hexctl.study.verdicts.claim_evidence import cm
from tests.study.transfer.made_up import (
    BUDGET,
    DURATION_S,
    OPTIMIZERS,
    WORLDS,
    plan,
    uncertainty_of,
)


def test_the_bars_follow_from_the_curves(findings: TransferFindings) -> None:
    short = transfer_bars(findings)
    assert {(bar.holds, bar.verdict) for bar in short} == {
        (None, f"not judged: walks of {DURATION_S:g} s, needs at least 30 s")
    }
    as_if = replace(findings, plan=replace(findings.plan, duration_s=30.0))
    bars = {bar.name: bar for bar in transfer_bars(as_if)}
    assert list(bars) == [bar.name for bar in short]
    mean = findings.by_trials("bayes", findings.places()).mean
    for name, bound_m, within in (("mean_0.1_m", 0.1, 4), ("mean_0.025_m", 0.025, 10)):
        assert bars[name].holds == bool((mean[:within] <= bound_m).any())
    share, _ = findings.coverage("bayes", findings.places())
    assert bars["coverage"].holds == (0.80 <= share <= 0.97)
    for kind in findings.kinds():
        theirs, ours = (
            findings.by_trials(name, findings.places(kind)).trials_to(0.1) for name in ("random", "bayes")
        )
        if theirs is not None and ours is not None:
            assert bars[f"{kind}_0.1_m"].holds == (ours <= theirs + 2)
    for bar in bars.values():
        assert bar.verdict == ("holds" if bar.holds else "does not hold")


def test_without_bayes_there_is_nothing_to_judge_and_small_budgets_ask_less(
    landscapes: list[Landscape],
) -> None:
    assert transfer_bars(search_worlds(plan(optimizers=("random",), runs=1), landscapes)) == []
    names = [
        bar.name for bar in transfer_bars(search_worlds(plan(optimizers=("bayes",), budget=5), landscapes))
    ]
    assert "mean_0.1_m" in names
    assert "mean_0.025_m" not in names


def test_the_report_is_one_page_with_figures_and_table_beside_it(
    findings: TransferFindings, tmp_path: Path
) -> None:
    assert write_transfer_report(findings, uncertainty_of(findings), tmp_path) == tmp_path / REPORT
    figures = {f"transfer_{name}.svg" for name in ("over_trials", "over_seconds", "kinds")}
    names = {path.name for path in tmp_path.iterdir()}
    assert figures | {REPORT, TABLE} <= names
    assert not any(name.endswith(".part") for name in names)
    text = (tmp_path / REPORT).read_text(encoding="utf-8")
    assert text.startswith("<!doctype html>")
    assert text.count("data:image/svg+xml;base64,") == 3
    for words in (*OPTIMIZERS, *findings.kinds(), f"{WORLDS} worlds", f"{BUDGET} trials"):
        assert words in text
    assert "own uncertainty is not known for these walks" in text  # they take some seconds
    assert transfer_json(findings, uncertainty_of(findings))["uncertainty"] is None
    table = pq.read_table(tmp_path / TABLE)
    assert table.num_rows == sum(
        len(course.codes) for courses in findings.courses.values() for course in courses
    )
    assert {"world", "kind", "leg", "optimizer", "run", "trial", "code", "best_m", "walked_s"} == set(
        table.column_names
    )


def test_the_summary_is_plain_json_of_the_curves(findings: TransferFindings) -> None:
    outcome = transfer_json(findings, uncertainty_of(findings))
    assert json.loads(json.dumps(outcome, allow_nan=False)) == outcome
    assert outcome["best_of_all_m"] == pytest.approx(findings.floor_m(findings.places()), rel=1e-3)
    for name in OPTIMIZERS:
        found = outcome["optimizers_found"][name]
        curves = findings.by_trials(name, findings.places())
        assert list(found["mean_m"]) == ["1", "2", "3", "4", "6", "8", "10", "15", "20"]
        assert found["mean_m"]["10"] == pytest.approx(curves.mean[9], rel=1e-3)
    assert outcome["optimizers_found"]["random"]["coverage"] is None


def test_a_mean_has_its_standard_error_over_worlds(findings: TransferFindings, tmp_path: Path) -> None:
    """The ± beside a mean over all worlds was that of one walk."""
    places, after = findings.places(), 10
    seeds = [findings.landscapes[place].spec.seed for place in places]
    assert len(set(seeds)) < len(seeds)
    by_world = [
        np.mean(
            [
                course.best_m[after - 1]
                for place, other in zip(places, seeds, strict=True)
                if other == seed
                for course in findings.courses[place, "bayes"]
            ]
        )
        for seed in dict.fromkeys(seeds)
    ]
    expected_m = np.std(by_world, ddof=1) / np.sqrt(len(by_world))
    found = transfer_json(findings, uncertainty_of(findings))["optimizers_found"]["bayes"]
    assert found["standard_error_m"]["10"] == pytest.approx(expected_m)
    page = write_transfer_report(findings, uncertainty_of(findings), tmp_path).read_text(encoding="utf-8")
    assert f"<td>{cm(found['mean_m']['10'])} ± {cm(expected_m)}</td>" in page


def test_one_world_one_optimizer_and_one_trial_make_a_report_too(
    landscapes: list[Landscape], tmp_path: Path
) -> None:
    found = search_worlds(plan(worlds=1, legs=(2,), optimizers=("bayes",), budget=1), landscapes[:1])
    assert write_transfer_report(found, uncertainty_of(found), tmp_path).exists()
    json.dumps(transfer_json(found, uncertainty_of(found)), allow_nan=False)
