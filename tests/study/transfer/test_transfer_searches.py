from dataclasses import replace

import numpy as np
import pytest

from hexctl.adapt.prior.samples import samples_of
from hexctl.study.landscape import Landscape
from hexctl.study.paper.searches import curve_of
from hexctl.study.transfer.transfer_plan import TransferFound
from hexctl.study.transfer.transfer_searches import (
    by_seconds,
    coverage,
    floor_m,
    make_search,
    run_course,
    search_worlds,
    sure_share,
    trials_to,
    walk_of,
)
from hexctl.study.transfer.transfer_settings import EARLY
from hexctl.types import FloatArray
from tests.adapt.priors import made_up_prior
from tests.study.made_up import made_up_in, spread_out
from tests.study.made_up_transfer import (
    BUDGET,
    DURATION_S,
    FALLING,
    LEGS,
    MODEL,
    OPTIMIZERS,
    RUNS,
    courses_of,
    found_in,
    plan,
    question,
)


def test_every_optimizer_runs_in_every_landscape(findings: TransferFound) -> None:
    assert findings.without == 0
    for place in range(6):
        for name in OPTIMIZERS:
            runs = 1 if name in ("bayes", EARLY) else RUNS
            assert [course.run for course in courses_of(findings, name, place)] == list(range(runs))


def test_a_course_is_what_the_landscape_has(landscapes: list[Landscape], findings: TransferFound) -> None:
    for place, landscape in enumerate(landscapes):
        runs = [one for name in OPTIMIZERS for one in courses_of(findings, name, place)]
        for course in runs:
            trials = len(course.codes)
            assert course.best_m.shape == course.walked_s.shape == (BUDGET,)
            assert 1 <= trials <= BUDGET
            assert (np.diff(course.best_m) <= 0).all()
            assert (np.diff(course.walked_s[:trials]) > 0).all()
            assert (course.best_m[trials:] == course.best_m[trials - 1]).all()
            assert (course.walked_s[trials:] == course.walked_s[trials - 1]).all()
            if course.optimizer == EARLY:
                continue
            rows = course.codes - 1
            best = np.minimum.accumulate(np.where(landscape.valid[rows], landscape.final_m[rows], np.inf))
            worst = landscape.final_m[landscape.valid].max()
            np.testing.assert_array_equal(course.best_m[:trials], np.minimum(best, worst))
            seconds = np.where(landscape.valid[rows], DURATION_S, DURATION_S / 2)
            np.testing.assert_allclose(course.walked_s[:trials], np.cumsum(seconds))


def test_searches_without_a_prior_spend_their_budget_on_different_gaits(findings: TransferFound) -> None:
    for name in ("pso", "random"):
        for place in range(6):
            courses = courses_of(findings, name, place)
            assert [len(set(course.codes.tolist())) for course in courses] == [BUDGET] * RUNS
            assert not any(course.sure or course.held.size for course in courses)
            assert not np.array_equal(courses[0].codes, courses[1].codes)


def test_a_course_is_the_same_again(landscapes: list[Landscape], findings: TransferFound) -> None:
    samples = samples_of(plan().prior, plan().robot, landscapes[3].spec.leg)
    again = run_course(make_search(plan(), landscapes[3], "random", 1, samples), landscapes[3], BUDGET)
    np.testing.assert_array_equal(again["codes"], courses_of(findings, "random", 3)[1].codes)
    np.testing.assert_array_equal(again["best_m"], courses_of(findings, "random", 3)[1].best_m)


def test_bayes_ends_when_it_is_sure_and_is_right(findings: TransferFound) -> None:
    sure = [course for course in courses_of(findings, "bayes") if course.sure]
    assert sure
    assert all(course.best_m[-1] <= 0.025 for course in sure)
    share, trials = sure_share(findings.of("bayes"))
    assert share == pytest.approx(len(sure) / 6)
    assert trials == pytest.approx(np.mean([len(course.codes) for course in sure]))
    assert sure_share(findings.of("random"))[0] == 0.0


def test_bayes_is_told_how_the_robot_stands_in_each_world(
    landscapes: list[Landscape], findings: TransferFound, monkeypatch: pytest.MonkeyPatch
) -> None:
    sags_rad = MODEL.sags(len(landscapes), seed=600)
    by_place = {one.spec.title: sag for one, sag in zip(landscapes, sags_rad, strict=True)}
    monkeypatch.setattr(
        "hexctl.study.transfer.transfer_searches.deflection_of", lambda spec: by_place[spec.title]
    )
    blind = made_up_prior(question(), legs=LEGS, worlds=16, model=MODEL)
    stances = np.array([MODEL.sags(16, leg) for leg in LEGS])
    asked = plan(prior=replace(blind, sag_rad=stances), optimizers=("bayes", "random"))
    told = found_in(asked, landscapes)
    samples = {leg: samples_of(asked.prior, asked.robot, leg) for leg in LEGS}
    others = 0
    for place, landscape in enumerate(landscapes):
        (course,) = courses_of(told, "bayes", place)
        leg = landscape.spec.leg
        search = make_search(asked, landscape, "bayes", 0, samples[leg], sags_rad[place])
        alone = run_course(search, landscape, asked.budget)
        np.testing.assert_array_equal(course.codes, alone["codes"])
        others += not np.array_equal(course.codes, courses_of(findings, "bayes", place)[0].codes)
        for ours, before in zip(
            courses_of(told, "random", place), courses_of(findings, "random", place), strict=True
        ):
            np.testing.assert_array_equal(ours.codes, before.codes)
    assert others > 0, "what it was told changed no choice"


def test_random_search_is_as_good_as_chance() -> None:
    """Its mean over many runs against the expectation of the best of n draws without repetition."""
    asked = plan(worlds=1, legs=(5,), optimizers=("random",), runs=200, budget=20)
    landscape = made_up_in(asked.specs()[0], spread_out(2.0))
    courses = courses_of(found_in(asked, [landscape]), "random")
    ends = np.sort(landscape.final_m)
    for n in (1, 5, 20):
        # The k-th smallest is the best when none of the k - 1 smaller ones is drawn, but it is.
        none_of = np.cumprod([1.0, *(1 - n / (120 - np.arange(119))).clip(0)])
        chances = none_of - np.append(none_of[1:], 0.0)
        best = np.array([course.best_m[n - 1] for course in courses])
        assert abs(best.mean() - chances @ ends) < 4 * best.std() / np.sqrt(best.size)


def test_before_the_first_trial_is_over_the_worst_gait_counts(
    landscapes: list[Landscape], findings: TransferFound
) -> None:
    worst = [landscape.final_m[landscape.valid].max() for landscape in landscapes]
    seconds = np.linspace(0.1, BUDGET * DURATION_S + 1, 50)
    for name in OPTIMIZERS:
        curves = by_seconds(findings.of(name), seconds)
        means = curves["mean_m"].to_numpy()
        assert means[0] == pytest.approx(np.mean(worst))
        assert (np.diff(means) <= 1e-12).all()
        assert means[-1] == pytest.approx(curve_of(findings.of(name))["mean_m"].iloc[-1])


def test_the_trials_to_a_bound_are_where_the_mean_crosses_it(findings: TransferFound) -> None:
    curves = curve_of(findings.of("random"))
    means = curves["mean_m"]
    count = trials_to(curves, float(means[8]))
    assert count is not None
    assert means[count] <= means[8]
    assert count == 1 or means[count - 1] > means[8]
    assert trials_to(curves, 0.0) is None


def test_coverage_counts_first_walks_that_came_to_their_end(findings: TransferFound) -> None:
    share, outcomes = coverage(findings.of("bayes"))
    expected = 0
    for course in courses_of(findings, "bayes"):
        expected += len(set(course.codes.tolist()) - set(FALLING))
    assert outcomes == expected
    assert 0.7 <= share <= 1.0
    assert coverage(findings.of("random"))[1] == 0


def test_kinds_and_reach_choose_landscapes(landscapes: list[Landscape], findings: TransferFound) -> None:
    by_kind = [set(findings.of("bayes", kind=kind)["place"]) for kind in findings.kinds]
    assert sorted(place for places in by_kind for place in places) == list(range(6))
    best = [landscape.best_m for landscape in landscapes]
    bound_m = float(np.median(best))
    within = [place for place, best_m in enumerate(best) if best_m <= bound_m]
    assert list(findings.reachable(bound_m)["place"].unique()) == within
    assert floor_m(findings.runs)[0] == pytest.approx(np.mean(best))


def test_it_is_told_of_each_landscape(landscapes: list[Landscape]) -> None:
    done: list[None] = []
    search_worlds(plan(optimizers=("random",), runs=1, budget=2), landscapes, lambda: done.append(None))
    assert len(done) == len(landscapes)


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
