import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from hexctl.study.landscape import Landscape
from hexctl.study.paper.evidence import cm
from hexctl.study.paper.searches import curve_of
from hexctl.study.transfer.transfer_plan import TransferFound
from hexctl.study.transfer.transfer_searches import coverage, floor_m, trials_to
from tests.study.made_up_transfer import (
    BUDGET,
    DURATION_S,
    OPTIMIZERS,
    WORLDS,
    found_in,
    plan,
)


def test_the_bars_follow_from_the_curves(findings: TransferFound) -> None:
    short = plan().bars(findings)
    assert {(bar.holds, bar.verdict) for bar in short} == {
        (None, f"not judged: walks of {DURATION_S:g} s, needs at least 30 s")
    }
    as_if = replace(plan(), duration_s=30.0)
    bars = {bar.name: bar for bar in as_if.bars(findings)}
    assert list(bars) == [bar.name for bar in short]
    mean = curve_of(findings.of("bayes"))["mean_m"]
    for name, bound_m, within in (("mean_0.1_m", 0.1, 4), ("mean_0.025_m", 0.025, 10)):
        assert bars[name].holds == bool((mean.loc[:within] <= bound_m).any())
    share, _ = coverage(findings.of("bayes"))
    assert bars["coverage"].holds == (0.80 <= share <= 0.97)
    for kind in findings.kinds:
        theirs, ours = (
            trials_to(curve_of(findings.of(name, kind=kind)), 0.1) for name in ("random", "bayes")
        )
        if theirs is not None and ours is not None:
            assert bars[f"{kind}_0.1_m"].holds == (ours <= theirs + 2)
    for bar in bars.values():
        assert bar.verdict == ("holds" if bar.holds else "does not hold")


def test_without_bayes_there_is_nothing_to_judge_and_small_budgets_ask_less(
    landscapes: list[Landscape],
) -> None:
    random, few = plan(optimizers=("random",), runs=1), plan(optimizers=("bayes",), budget=5)
    assert random.bars(found_in(random, landscapes)) == []
    names = [bar.name for bar in few.bars(found_in(few, landscapes))]
    assert "mean_0.1_m" in names
    assert "mean_0.025_m" not in names


@pytest.mark.slow
def test_the_report_is_one_page_with_figures_and_table_beside_it(
    findings: TransferFound, tmp_path: Path
) -> None:
    assert plan().write(findings, tmp_path) == tmp_path / "transfer.html"
    figures = {f"transfer_{name}.svg" for name in ("over_trials", "over_seconds", "kinds")}
    names = {path.name for path in tmp_path.iterdir()}
    assert figures | {"transfer.html", "transfer.parquet"} <= names
    assert not any(name.endswith(".part") for name in names)
    text = (tmp_path / "transfer.html").read_text(encoding="utf-8")
    assert text.startswith("<!doctype html>")
    assert text.count("data:image/svg+xml;base64,") == 3
    for words in (*OPTIMIZERS, *findings.kinds, f"{WORLDS} worlds", f"{BUDGET} trials"):
        assert words in text
    assert "own uncertainty is not known for these walks" in text  # they take some seconds
    assert plan().numbers(findings)["uncertainty"] is None
    table = pq.read_table(tmp_path / "transfer.parquet")
    assert table.num_rows == sum(map(len, findings.runs["codes"]))
    assert {"world", "kind", "leg", "optimizer", "run", "trial", "code", "best_m", "walked_s"} == set(
        table.column_names
    )


def test_the_summary_is_plain_json_of_the_curves(findings: TransferFound) -> None:
    outcome = plan().numbers(findings)
    assert json.loads(json.dumps(outcome, allow_nan=False)) == outcome
    assert outcome["best_of_all_m"] == pytest.approx(floor_m(findings.runs)[0], rel=1e-3)
    for name in OPTIMIZERS:
        found = outcome["optimizers_found"][name]
        curves = curve_of(findings.of(name))
        assert list(found["mean_m"]) == ["1", "2", "3", "4", "6", "8", "10", "15", "20"]
        assert found["mean_m"]["10"] == pytest.approx(curves["mean_m"][10], rel=1e-3)
    assert outcome["optimizers_found"]["random"]["coverage"] is None


@pytest.mark.slow
def test_a_mean_has_its_standard_error_over_worlds(findings: TransferFound, tmp_path: Path) -> None:
    """The ± beside a mean over all worlds was that of one walk."""
    runs, after = findings.of("bayes"), 10
    assert runs["world"].nunique() < runs["place"].nunique()
    by_world = [
        np.mean([best_m[after - 1] for best_m in some["best_m"]]) for _, some in runs.groupby("world")
    ]
    expected_m = np.std(by_world, ddof=1) / np.sqrt(len(by_world))
    found = plan().numbers(findings)["optimizers_found"]["bayes"]
    assert found["standard_error_m"]["10"] == pytest.approx(expected_m)
    page = plan().write(findings, tmp_path).read_text(encoding="utf-8")
    assert f"<td>{cm(found['mean_m']['10'])} ± {cm(expected_m)}</td>" in page


@pytest.mark.slow
def test_one_world_one_optimizer_and_one_trial_make_a_report_too(
    landscapes: list[Landscape], tmp_path: Path
) -> None:
    asked = plan(worlds=1, legs=(2,), optimizers=("bayes",), budget=1)
    found = found_in(asked, landscapes[:1])
    assert asked.write(found, tmp_path).exists()
    json.dumps(asked.numbers(found), allow_nan=False)
