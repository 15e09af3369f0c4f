"""Courses, curves, bars and report of a benchmark, number by number; some gaits fall on their way."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from hexctl.adapt.prior.prior import PriorKey
from hexctl.adapt.prior.samples import FINAL, samples_of
from hexctl.backends.sim.world import load_randomization
from hexctl.errors import InputError
from hexctl.study.landscape import NUMBERS, Landscape, LandscapeSpec, Rows, empty_landscape, with_rows
from hexctl.study.prior import PriorPlan
from hexctl.study.transfer.plan import EARLY, FIRST_WORLD, TransferPlan
from hexctl.study.transfer.report import REPORT, TABLE, transfer_bars, transfer_json, write_transfer_report
from hexctl.study.transfer.searches import TransferFindings, run_course, search_worlds, walk_of
from hexctl.types import FloatArray
from tests.adapt.priors import MadeUpModel, key_of, made_up_prior, path_of, plan_of
from tests.robots import shipped
from tests.study.landscapes import made_up_in, spread_out

DURATION_S = 6.0
LEGS, WORLDS, BUDGET, RUNS = (2, 5), 3, 20, 2
OPTIMIZERS = ("bayes", EARLY, "pso", "random")
MODEL = MadeUpModel(seed=4)

#: Codes of gaits that fall after half of their time.
FALLING = (12, 51, 94)


def question(name: str = "ant", **options: Any) -> PriorKey:
    return key_of(shipped(name), **{"duration_s": DURATION_S, **options})


def plan(**options: Any) -> TransferPlan:
    given: dict[str, Any] = {
        "robot": shipped(),
        "family": load_randomization("transfer"),
        "prior": made_up_prior(question(), legs=LEGS, worlds=16, model=MODEL),
        "worlds": WORLDS,
        "legs": LEGS,
        "optimizers": OPTIMIZERS,
        "runs": RUNS,
        "budget": BUDGET,
        "duration_s": DURATION_S,
    }
    return TransferPlan(**given | options)


def in_the_model(spec: LandscapeSpec, features: FloatArray) -> Landscape:
    """Return a landscape whose gaits walk as in a world of the made-up model."""
    empty, points = empty_landscape(spec), spec.n_points
    at = np.arange(1, points + 1) / points * 10
    paths = np.empty((120, points, 2), dtype=np.float32)
    for row, path in enumerate(path_of(one) for one in features):
        for column in (0, 1):
            paths[row, :, column] = np.interp(at, np.arange(11), [0, *path[:, column]])
    numbers = np.zeros((120, len(NUMBERS)))
    numbers[:, NUMBERS.index("signed_m")] = features[:, FINAL]
    numbers[:, NUMBERS.index("distance_m")] = features[:, -2]
    numbers[:, NUMBERS.index("yaw_change_rad")] = features[:, -1]
    status = np.full(120, "ok", dtype="<U16")
    for code in FALLING:
        status[code - 1] = "fell"
        paths[code - 1, points // 2 :] = np.nan
    return with_rows(empty, Rows(codes=empty.codes, status=status, numbers=numbers, paths_m=paths))


@pytest.fixture(scope="module")
def landscapes() -> list[Landscape]:
    specs = plan().specs()
    worlds = MODEL.worlds(len(specs), seed=600)
    return [in_the_model(spec, world) for spec, world in zip(specs, worlds, strict=True)]


@pytest.fixture(scope="module")
def findings(landscapes: list[Landscape]) -> TransferFindings:
    return search_worlds(plan(), landscapes)


def test_landscapes_come_world_by_world_from_behind_those_that_were_looked_at() -> None:
    asked = plan()
    specs = asked.specs()
    assert [(spec.seed, spec.leg) for spec in specs] == [
        (FIRST_WORLD + world, leg) for world in range(WORLDS) for leg in LEGS
    ]
    assert [spec.world for spec in specs[:: len(LEGS)]] == asked.family.members(FIRST_WORLD, WORLDS)
    assert {(spec.self_rotation, spec.placed) for spec in specs} == {("rear", False)}


def test_no_world_has_a_value_in_common_with_one_of_a_prior() -> None:
    believed = load_randomization("randomised")
    known = PriorPlan(robot=shipped(), family=believed, worlds=100).specs()
    for key in believed.ranges:
        tried = {json.dumps(spec.world.model_dump()[key]) for spec in plan(worlds=100).specs()}
        assert not tried & {json.dumps(spec.world.model_dump()[key]) for spec in known}


def test_every_run_has_a_seed_of_its_own() -> None:
    asked = plan(worlds=30, legs=(1, 2, 3, 4, 5, 6), runs=5)
    seeds = [asked.seed_of(spec, run) for spec in asked.specs() for run in range(5)]
    assert len(set(seeds)) == len(seeds) == 30 * 6 * 5
    other = replace(asked, seed=1)
    assert not {other.seed_of(spec, run) for spec in other.specs() for run in range(5)} & set(seeds)


@pytest.mark.parametrize(("options", "words"), [
    ({"worlds": 1001}, "--worlds: got 1001; allowed: 1..1000"),
    ({"legs": ()}, "--legs"),
    ({"legs": (2, 2)}, "--legs: got [2, 2]"),
    ({"seed": -1}, "--seed: got -1"),
    ({"optimizers": ("random", "random")}, "--optimizers: got random,random"),
    ({"duration_s": float("nan")}, "--duration"),
    ({"duration_s": float("inf")}, "--duration"),
    ({"prior": made_up_prior(question(self_rotation="front"))}, "self-rotation front, not rear"),
    ({"prior": made_up_prior(question("phantomx"))}, "robot phantomx, not ant"),
], ids=lambda value: value if isinstance(value, str) else "-")  # fmt: skip
def test_what_cannot_be_done_is_refused_in_one_line(options: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError) as refused:
        plan(**options).check()
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_prior_that_says_nothing_about_a_leg_is_refused_before_anything_runs() -> None:
    pexod = shipped("pexod")
    prior = made_up_prior(question("pexod"), legs=(1,))
    with pytest.raises(InputError, match=r"nothing on legs \[2\]"):
        plan(robot=pexod, prior=prior, legs=(1, 2)).check()
    plan(robot=pexod, prior=prior, legs=(1, 6)).check()


def test_no_optimizers_are_refused() -> None:
    with pytest.raises(InputError, match="--optimizers"):
        plan(optimizers=()).check()


def test_every_optimizer_runs_in_every_landscape(findings: TransferFindings) -> None:
    assert findings.without == 0
    assert set(findings.courses) == {(place, name) for place in range(6) for name in OPTIMIZERS}
    for (_, name), courses in findings.courses.items():
        assert len(courses) == (1 if name in ("bayes", EARLY) else RUNS)


def test_a_course_is_what_the_landscape_has(findings: TransferFindings) -> None:
    for (place, name), courses in findings.courses.items():
        landscape = findings.landscapes[place]
        for course in courses:
            trials = len(course.codes)
            assert course.best_m.shape == course.walked_s.shape == (BUDGET,)
            assert 1 <= trials <= BUDGET
            assert (np.diff(course.best_m) <= 0).all()
            assert (np.diff(course.walked_s[:trials]) > 0).all()
            assert (course.best_m[trials:] == course.best_m[trials - 1]).all()
            assert (course.walked_s[trials:] == course.walked_s[trials - 1]).all()
            if name == EARLY:
                continue
            rows = course.codes - 1
            best = np.minimum.accumulate(np.where(landscape.valid[rows], landscape.final_m[rows], np.inf))
            worst = landscape.final_m[landscape.valid].max()
            np.testing.assert_array_equal(course.best_m[:trials], np.minimum(best, worst))
            seconds = np.where(landscape.valid[rows], DURATION_S, DURATION_S / 2)
            np.testing.assert_allclose(course.walked_s[:trials], np.cumsum(seconds))


def test_searches_without_a_prior_spend_their_budget_on_different_gaits(findings: TransferFindings) -> None:
    for (_, name), courses in findings.courses.items():
        if name in ("pso", "random"):
            assert [len(set(course.codes.tolist())) for course in courses] == [BUDGET] * RUNS
            assert not any(course.sure or course.held.size for course in courses)
            assert not np.array_equal(courses[0].codes, courses[1].codes)


def test_a_course_is_the_same_again(landscapes: list[Landscape], findings: TransferFindings) -> None:
    again = run_course(plan(), landscapes[3], "random", 1, None)
    np.testing.assert_array_equal(again.codes, findings.courses[3, "random"][1].codes)
    np.testing.assert_array_equal(again.best_m, findings.courses[3, "random"][1].best_m)


def test_bayes_ends_when_it_is_sure_and_is_right(findings: TransferFindings) -> None:
    sure = [course for (_, name), (course, *_) in findings.courses.items() if name == "bayes" and course.sure]
    assert sure
    assert all(course.best_m[-1] <= 0.025 for course in sure)
    share, trials = findings.sure_share("bayes", findings.places())
    assert share == pytest.approx(len(sure) / 6)
    assert trials == pytest.approx(np.mean([len(course.codes) for course in sure]))
    assert findings.sure_share("random", findings.places())[0] == 0.0


def test_bayes_is_told_how_the_robot_stands_in_each_world(
    landscapes: list[Landscape], findings: TransferFindings, monkeypatch: pytest.MonkeyPatch
) -> None:
    sags_rad = MODEL.sags(len(landscapes), seed=600)
    by_place = {one.spec.title: sag for one, sag in zip(landscapes, sags_rad, strict=True)}
    monkeypatch.setattr("hexctl.study.transfer.searches.deflection_of", lambda spec: by_place[spec.title])
    blind = made_up_prior(question(), legs=LEGS, worlds=16, model=MODEL)
    stances = np.array([MODEL.sags(16, leg) for leg in LEGS])
    asked = plan(prior=replace(blind, sag_rad=stances), optimizers=("bayes", "random"))
    told = search_worlds(asked, landscapes)
    samples = {leg: samples_of(asked.prior, asked.robot, leg) for leg in LEGS}
    others = 0
    for place, landscape in enumerate(landscapes):
        (course,) = told.courses[place, "bayes"]
        leg = landscape.spec.leg
        alone = run_course(asked, landscape, "bayes", 0, samples[leg], sags_rad[place])
        np.testing.assert_array_equal(course.codes, alone.codes)
        others += not np.array_equal(course.codes, findings.courses[place, "bayes"][0].codes)
        for ours, before in zip(
            told.courses[place, "random"], findings.courses[place, "random"], strict=True
        ):
            np.testing.assert_array_equal(ours.codes, before.codes)
    assert others > 0, "what it was told changed no choice"


def test_random_search_is_as_good_as_chance() -> None:
    """Its mean over many runs against the expectation of the best of n draws without repetition."""
    asked = plan(worlds=1, legs=(5,), optimizers=("random",), runs=200, budget=20)
    landscape = made_up_in(asked.specs()[0], spread_out(2.0))
    courses = search_worlds(asked, [landscape]).courses[0, "random"]
    ends = np.sort(landscape.final_m)
    for n in (1, 5, 20):
        # The k-th smallest is the best when none of the k - 1 smaller ones is drawn, but it is.
        none_of = np.cumprod([1.0, *(1 - n / (120 - np.arange(119))).clip(0)])
        chances = none_of - np.append(none_of[1:], 0.0)
        best = np.array([course.best_m[n - 1] for course in courses])
        assert abs(best.mean() - chances @ ends) < 4 * best.std() / np.sqrt(best.size)


def test_before_the_first_trial_is_over_the_worst_gait_counts(findings: TransferFindings) -> None:
    places = findings.places()
    worst = [landscape.final_m[landscape.valid].max() for landscape in findings.landscapes]
    seconds = np.linspace(0.1, BUDGET * DURATION_S + 1, 50)
    for name in OPTIMIZERS:
        curves = findings.by_seconds(name, places, seconds)
        assert curves.mean[0] == pytest.approx(np.mean(worst))
        assert (np.diff(curves.mean) <= 1e-12).all()
        assert curves.mean[-1] == pytest.approx(findings.by_trials(name, places).mean[-1])


def test_the_trials_to_a_bound_are_where_the_mean_crosses_it(findings: TransferFindings) -> None:
    curves = findings.by_trials("random", findings.places())
    count = curves.trials_to(float(curves.mean[7]))
    assert count is not None
    assert curves.mean[count - 1] <= curves.mean[7]
    assert count == 1 or curves.mean[count - 2] > curves.mean[7]
    assert curves.trials_to(0.0) is None


def test_coverage_counts_first_walks_that_came_to_their_end(findings: TransferFindings) -> None:
    share, outcomes = findings.coverage("bayes", findings.places())
    expected = 0
    for place in findings.places():
        (course,) = findings.courses[place, "bayes"]
        expected += len(set(course.codes.tolist()) - set(FALLING))
    assert outcomes == expected
    assert 0.7 <= share <= 1.0
    assert findings.coverage("random", findings.places())[1] == 0


def test_kinds_and_reach_choose_landscapes(findings: TransferFindings) -> None:
    kinds = findings.kinds()
    assert sorted(place for kind in kinds for place in findings.places(kind)) == findings.places()
    best = [landscape.best_m for landscape in findings.landscapes]
    bound_m = float(np.median(best))
    assert findings.places(reachable_m=bound_m) == [
        place for place, best_m in enumerate(best) if best_m <= bound_m
    ]
    assert findings.floor_m(findings.places()) == pytest.approx(np.mean(best))


def test_it_is_told_of_each_landscape(landscapes: list[Landscape]) -> None:
    done: list[Landscape] = []
    search_worlds(plan(optimizers=("random",), runs=1, budget=2), landscapes, done.append)
    assert done == landscapes


def test_a_fall_is_walked_to_where_it_happened(landscapes: list[Landscape]) -> None:
    fell = walk_of(landscapes[0], FALLING[0])
    assert (fell.status, fell.duration_s, fell.finished) == ("fell", DURATION_S / 2, False)
    assert np.isfinite(fell.path_m).all()
    asked: list[int] = []

    def never_enough(path_m: FloatArray) -> bool:
        asked.append(len(path_m))
        return False

    walk_of(landscapes[0], FALLING[0], never_enough)
    assert asked == [50, 100]


def test_a_walk_that_is_over_anyway_is_not_cut_short(landscapes: list[Landscape]) -> None:
    shown = walk_of(landscapes[0], 7, lambda path: len(path) >= 300)
    assert (shown.status, shown.duration_s) == ("ok", DURATION_S)


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
    assert write_transfer_report(findings, tmp_path) == tmp_path / REPORT
    figures = {f"transfer_{name}.png" for name in ("over_trials", "over_seconds", "kinds")}
    names = {path.name for path in tmp_path.iterdir()}
    assert figures | {REPORT, TABLE} <= names
    assert not any(name.endswith(".part") for name in names)
    text = (tmp_path / REPORT).read_text(encoding="utf-8")
    assert text.startswith("<!doctype html>")
    assert text.count("data:image/png;base64,") == 3
    for words in (*OPTIMIZERS, *findings.kinds(), f"{WORLDS} worlds", f"{BUDGET} trials"):
        assert words in text
    table = pq.read_table(tmp_path / TABLE)
    assert table.num_rows == sum(
        len(course.codes) for courses in findings.courses.values() for course in courses
    )
    assert {"world", "kind", "leg", "optimizer", "run", "trial", "code", "best_m", "walked_s"} == set(
        table.column_names
    )


def test_the_summary_is_plain_json_of_the_curves(findings: TransferFindings) -> None:
    outcome = transfer_json(findings)
    assert json.loads(json.dumps(outcome, allow_nan=False)) == outcome
    assert outcome["best_of_all_m"] == pytest.approx(findings.floor_m(findings.places()), rel=1e-3)
    for name in OPTIMIZERS:
        found = outcome["optimizers_found"][name]
        curves = findings.by_trials(name, findings.places())
        assert list(found["mean_m"]) == ["1", "2", "3", "4", "6", "8", "10", "15", "20"]
        assert found["mean_m"]["10"] == pytest.approx(curves.mean[9], rel=1e-3)
    assert outcome["optimizers_found"]["random"]["coverage"] is None


def test_one_world_one_optimizer_and_one_trial_make_a_report_too(
    landscapes: list[Landscape], tmp_path: Path
) -> None:
    found = search_worlds(plan(worlds=1, legs=(2,), optimizers=("bayes",), budget=1), landscapes[:1])
    assert write_transfer_report(found, tmp_path).exists()
    json.dumps(transfer_json(found), allow_nan=False)


def test_the_trials_of_the_benchmark_are_those_of_a_session() -> None:
    session = PriorKey.of(shipped(), plan_of(shipped(), duration_s=DURATION_S))
    assert PriorKey.of(shipped(), plan().trial_plan()).differences(session) == []
