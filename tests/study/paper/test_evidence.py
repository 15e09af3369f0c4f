"""Tolerances, intervals over worlds and verdicts."""

import pytest
from scipy import stats

from hexctl.study.paper.claims import null_share
from hexctl.study.paper.evidence import (
    Measure,
    Tolerance,
    cm,
    judge,
    judge_all,
    wilson_interval,
)


def test_about_a_number_is_half_of_it_to_both_sides() -> None:
    about = Tolerance.about(0.1)
    assert (about.low, about.high) == pytest.approx((0.05, 0.15))
    assert Tolerance.about(40, 60) == Tolerance(20, 90)


def test_the_interval_over_worlds_is_students() -> None:
    values = (0.08, 0.11, 0.09, 0.14)
    expected = stats.t.interval(0.95, 3, loc=sum(values) / 4, scale=stats.sem(values))
    assert Measure("pso", values).interval == pytest.approx(expected)
    assert Measure("share", (0.9, 1.0), most=1.0).interval == pytest.approx((0.3147, 1.0), abs=1e-4)
    assert Measure("pso", (0.01, 0.3)).interval[0] == 0.0
    assert Measure("pso", (0.08, float("nan"))).interval == (0.08, 0.08)


@pytest.mark.parametrize(("count", "of"), [(0, 10), (3, 10), (10, 10), (999, 1000)])
def test_the_interval_of_a_share_is_wilsons(count: int, of: int) -> None:
    expected = stats.binomtest(count, of).proportion_ci(method="wilson")
    assert wilson_interval(count, of) == pytest.approx((expected.low, expected.high))
    assert wilson_interval(0, 0) == (0.0, 1.0)


@pytest.mark.parametrize(
    ("values", "where"),
    [
        ((0.1,), "within"),
        ((0.03,), "below"),
        ((0.2,), "above"),
        ((0.09, 0.1, 0.11), "within"),
        ((0.05, 0.1, 0.15), "across"),
        ((0.2, 0.21, 0.22), "above"),
        ((float("nan"),), "unknown"),
    ],
)
def test_an_interval_is_within_outside_or_across(values: tuple[float, ...], where: str) -> None:
    assert judge(Measure("pso", values), Tolerance.about(0.1)) == where


def test_one_number_outside_is_enough_and_one_unknown_leaves_open() -> None:
    good, high = Measure("pso", (0.1,)), Measure("dps", (0.3,))
    none = Measure("leg 2", (float("nan"),), "0 valid")
    about = Tolerance.about(0.1)
    assert judge_all([good], about).holds is True
    assert judge_all([good, high, none], about).holds is False
    assert judge_all([good, none], about).not_judged == "leg 2: 0 valid"
    assert judge_all([], about).holds is None


def test_nineteen_draws_without_success_are_five_percent() -> None:
    assert null_share([False] * 19) == 0.05
    assert null_share([True, *[None] * 18]) == 0.1


def test_small_lengths_keep_a_digit() -> None:
    assert (cm(0.123), cm(0.0004), cm(float("nan"))) == ("12.3 cm", "0.04 cm", "none")
