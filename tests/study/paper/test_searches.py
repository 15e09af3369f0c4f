import math
from collections.abc import Sequence

import numpy as np
import pytest
from pandas import DataFrame

from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.optimizers.deduplication import Deduplication
from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.optimizers.shipped import OPTIMIZERS
from hexctl.errors import InputError
from hexctl.study.frames import where
from hexctl.study.landscape import Landscape
from hexctl.study.paper.searches import ALL, FRESH, PAPER, codes_until_stuck, curve_of, search_landscape
from hexctl.types import FloatArray
from tests.study.made_up import best_m, made_up, made_up_findings, spec, spread_out

SEEDS = (5000, 5001, 5002, 5003)
INVALID = range(1, 100, 2)


@pytest.fixture(scope="module")
def landscape() -> Landscape:
    return made_up(5, "rear", spread_out(2.0), invalid=list(INVALID))


def brute_force(landscape: Landscape, name: str, seed: int, budget: int, *, paper_count: bool) -> list[float]:
    """The best valid deviation after each evaluation, step by step and without arrays."""
    search = Deduplication(make_optimizer(name, landscape.spec.space, seed), seed, paper_count=paper_count)
    best, curve = math.nan, []
    for _ in range(budget):
        if not search.exhausted:
            (code,) = search.ask(1)
            final_m = abs(float(landscape.number("signed_m")[code - 1]))
            valid = landscape.status[code - 1] == "ok"
            search.tell([code], [final_m if valid else INVALID_SCORE])
            if valid and not best <= final_m:
                best = final_m
        curve.append(best)
    return curve


@pytest.mark.parametrize("name", list(OPTIMIZERS))
def test_curves_are_those_of_a_step_by_step_search(landscape: Landscape, name: str) -> None:
    for run in search_landscape(landscape, name, SEEDS, 130):
        paper_count = run["count"] == PAPER
        expected = brute_force(landscape, name, run["seed"], 130, paper_count=paper_count)
        np.testing.assert_array_equal(run["best_m"], expected)


def by_count(landscape: Landscape, name: str, seeds: Sequence[int], budget: int) -> list[DataFrame]:
    runs = DataFrame(search_landscape(landscape, name, seeds, budget))
    return [where(runs, count=count) for count in (FRESH, PAPER)]


def test_the_fresh_count_pays_for_each_code_once_and_ends_with_all(landscape: Landscape) -> None:
    fresh, paper = by_count(landscape, "pso", SEEDS, 130)
    assert [np.unique(codes[codes > 0]).size for codes in fresh["codes"]] == [120] * 4
    assert all((codes[120:] == 0).all() for codes in fresh["codes"])
    assert {best_m[-1] for best_m in fresh["best_m"]} == {landscape.best_m}
    assert all(np.unique(codes).size < 120 for codes in paper["codes"])
    assert all((codes > 0).all() for codes in paper["codes"])


@pytest.mark.slow
def test_random_draws_as_well_as_theory_says() -> None:
    ranks = np.arange(1.0, 121.0)
    fresh, _ = by_count(made_up(5, "rear", ranks), "random", range(1500), 20)
    assert curve_of(fresh)["mean_m"][20] == pytest.approx(121 / 21, rel=0.05)


def curve(best_m: list[list[float]]) -> DataFrame:
    return curve_of(DataFrame({"best_m": [np.array(run) for run in best_m]}))


def test_statistics_leave_out_runs_without_a_valid_gait() -> None:
    nan = math.nan
    found = curve([[nan, 3.0, 1.0], [nan, nan, 2.0], [nan, 5.0, 3.0]])
    np.testing.assert_allclose(found["mean_m"], [nan, 4.0, 2.0])
    np.testing.assert_allclose(found["median_m"], [nan, 4.0, 2.0])
    np.testing.assert_allclose(found["std_m"], [nan, 1.0, math.sqrt(2 / 3)])
    np.testing.assert_allclose(found["p10_m"], [nan, 3.2, 1.2])
    np.testing.assert_allclose(found["share_of_runs"], [0, 2 / 3, 1])


def test_statistics_of_nothing_are_nothing() -> None:
    found = curve([[math.nan] * 3] * 2)
    assert found["mean_m"].isna().all()
    assert found["share_of_runs"].tolist() == [0, 0, 0]


def test_a_landscape_without_a_valid_gait_has_no_best() -> None:
    nowhere = made_up(5, "rear", spread_out(2.0), invalid=range(1, 121))
    for run in search_landscape(nowhere, "derand", SEEDS, 30):
        assert np.isnan(run["best_m"]).all()


def test_searches_get_stuck_and_random_does_not(landscape: Landscape) -> None:
    scores: FloatArray = landscape.scores
    stuck = codes_until_stuck("pso", landscape.spec.space, 1, scores)
    assert 10 <= stuck < 120
    assert codes_until_stuck("random", landscape.spec.space, 1, scores) == 120
    # What is asked for until then is what the fresh count evaluates first.
    fresh, _ = by_count(landscape, "pso", [1], 120)
    assert fresh["own_codes"].tolist() == [stuck]


def test_half_a_landscape_is_not_searched() -> None:
    half = spec(duration_s=0.2, codes=range(1, 61))
    few = Landscape.of(half, half.walk([1]) * 60)
    with pytest.raises(InputError, match="got 60 gaits"):
        search_landscape(few, "random", SEEDS, 10)


def test_means_are_over_legs_and_runs() -> None:
    findings = made_up_findings(spread_out(1.0), legs=(1, 4), optimizers=("random",), runs=4, budget=20)
    each = [best_m(findings, leg=leg, count=FRESH)[:, 19] for leg in (1, 4)]
    mean = findings.curves[ALL, "random", FRESH]["mean_m"][20]
    assert mean == pytest.approx(np.concatenate(each).mean())


def test_runs_have_seeds_of_their_own_that_adapt_takes() -> None:
    plan = made_up_findings(spread_out(1.0), legs=(1, 4), optimizers=("random",), runs=4, budget=5).plan
    seeds = [plan.seed_of(leg, run) for leg in plan.legs for run in range(4)]
    assert len(set(seeds)) == 8
    assert min(seeds) >= 0
