"""Which gait is walked next, and the probabilities behind it, against SciPy, integrals and chance."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import foldnorm, norm

from hexctl.adapt.prior.acquisition import (
    chance_above,
    chance_within,
    expected_excess,
    expected_gain_m,
    expected_size_m,
    most_promising,
    most_useful,
)
from hexctl.adapt.prior.belief import Forecast
from hexctl.types import FloatArray

CASES = [
    (0.0, 0.1, 0.05),
    (0.3, 0.1, 0.05),
    (-0.3, 0.2, 0.4),
    (1.0, 0.01, 0.5),
    (0.02, 0.001, 0.025),
    (-0.5, 1.0, 0.1),
    (0.0, 0.0005, 0.5),
]

metres = st.floats(-2, 2)
spreads = st.floats(1e-3, 2)


def one(value: float) -> FloatArray:
    return np.array([value])


@given(mean=metres, sd=spreads, bound=st.floats(0, 2))
def test_chances_are_scipys(mean: float, sd: float, bound: float) -> None:
    within = norm.cdf(bound, mean, sd) - norm.cdf(-bound, mean, sd)
    assert chance_within(one(mean), one(sd), bound)[0] == pytest.approx(within, abs=1e-12)
    assert chance_above(one(mean), one(sd), bound)[0] == pytest.approx(norm.sf(bound, mean, sd), abs=1e-12)


@pytest.mark.parametrize(("mean", "sd", "best"), CASES)
def test_the_expected_gain_is_its_integral(mean: float, sd: float, best: float) -> None:
    wanted, _ = quad(
        lambda x: (best - abs(x)) * norm.pdf(x, mean, sd),
        -best,
        best,
        points=sorted({0.0, min(max(mean, -best), best)}),
        limit=500,
        epsabs=1e-12,
    )
    assert expected_gain_m(one(mean), one(sd), best)[0] == pytest.approx(wanted, abs=1e-9)


@pytest.mark.parametrize(("mean", "sd", "best"), CASES)
def test_the_expected_gain_is_what_chance_brings(mean: float, sd: float, best: float) -> None:
    ends = np.random.default_rng(0).normal(mean, sd, 200_000)
    gains = np.maximum(0.0, best - np.abs(ends))
    # Four standard errors.
    tolerance = 4 * gains.std() / math.sqrt(gains.size) + 1e-12
    assert expected_gain_m(one(mean), one(sd), best)[0] == pytest.approx(gains.mean(), abs=tolerance)


@given(mean=metres, sd=spreads, best=st.floats(0.001, 0.5))
def test_a_gain_is_no_loss_no_more_than_all_there_is_and_the_same_on_both_sides(
    mean: float, sd: float, best: float
) -> None:
    gain = expected_gain_m(one(mean), one(sd), best)[0]
    assert -1e-12 <= gain <= best + 1e-12
    assert expected_gain_m(one(-mean), one(sd), best)[0] == pytest.approx(gain, abs=1e-12)


def test_a_gait_that_certainly_ends_on_the_line_gains_everything() -> None:
    assert expected_gain_m(one(0.0), one(1e-6), 0.3)[0] == pytest.approx(0.3, abs=1e-5)
    assert expected_gain_m(one(0.1), one(1e-6), 0.3)[0] == pytest.approx(0.2, abs=1e-5)
    assert expected_gain_m(one(0.4), one(1e-6), 0.3)[0] == pytest.approx(0.0, abs=1e-9)


def forecast(mean_m: FloatArray, sd_m: FloatArray | float, common: float = 0.0) -> Forecast:
    """A forecast of gaits that have a share of their deviation in common."""
    sd = np.broadcast_to(np.asarray(sd_m, dtype=float), mean_m.shape)
    alike = common + (1 - common) * np.eye(mean_m.size)
    return Forecast(
        mean_m=mean_m,
        covariance_m2=np.outer(sd, sd) * alike,
        distance_m=np.full(mean_m.size, 4.0),
        distance_sd_m=np.full(mean_m.size, 0.1),
        noise_m=0.001,
        widened=1.0,
    )


@given(mean=metres, sd=spreads)
def test_the_expected_size_is_the_mean_of_the_folded_normal(mean: float, sd: float) -> None:
    wanted = foldnorm.mean(abs(mean) / sd, scale=sd)
    assert expected_size_m(one(mean), one(sd))[0] == pytest.approx(wanted, abs=1e-9)
    assert expected_size_m(one(mean), one(sd))[0] >= abs(mean) - 1e-12


NONE_TRIED = np.zeros(120, dtype=bool)
ALL_WALK = np.ones(120)


@pytest.mark.parametrize("row", [0, 57, 119])
@pytest.mark.parametrize("best_m", [math.inf, 0.2])
def test_the_obvious_gait_is_picked(row: int, best_m: float) -> None:
    mean, sd = np.full(120, 1.5), np.full(120, 0.05)
    mean[row], sd[row] = 0.0, 1e-3
    assert most_useful(forecast(mean, sd), ALL_WALK, NONE_TRIED, best_m) == row


@given(seed=st.integers(0, 10_000), tried=st.integers(0, 119), best_m=st.sampled_from([math.inf, 0.3, 1e-3]))
def test_a_gait_that_was_tried_is_never_picked(seed: int, tried: int, best_m: float) -> None:
    random = np.random.default_rng(seed)
    rows = random.permutation(120)[:tried]
    known = NONE_TRIED.copy()
    known[rows] = True
    mean, sd = random.uniform(-1.5, 1.5, 120), random.uniform(0.001, 0.5, 120)
    mean[rows], sd[rows] = 0.0, 1e-5
    row = most_useful(forecast(mean, sd, common=0.3), random.uniform(0, 1, 120), known, best_m)
    assert not known[row]


def test_a_gait_that_was_tried_is_not_picked_even_where_nothing_can_be_gained() -> None:
    """No gait can walk, or the best one is perfect: still something untried is named."""
    known = NONE_TRIED.copy()
    known[:119] = True
    mean = np.linspace(-1, 1, 120)
    assert most_useful(forecast(mean, 0.1), ALL_WALK, known, 0.0) == 119
    assert most_useful(forecast(mean, 0.1), np.zeros(120), known, 0.5) == 119


def test_a_gait_that_cannot_walk_is_not_worth_a_trial() -> None:
    mean = np.full(120, 1.5)
    mean[20] = 0.0
    assert most_useful(forecast(mean, 0.05), ALL_WALK, NONE_TRIED, math.inf) == 20
    assert most_useful(forecast(mean, 0.05), np.where(mean == 0, 0.0, 1.0), NONE_TRIED, math.inf) != 20


@pytest.mark.parametrize(("mean_m", "sd_m"), [(0.1, 0.05), (0.3, 0.05), (0.2, 0.1), (0.08, 0.1)])
def test_the_only_gait_that_promises_anything_is_not_put_off(mean_m: float, sd_m: float) -> None:
    mean, sd = np.full(120, 1.5), np.full(120, 0.05)
    mean[80], sd[80] = mean_m, sd_m
    assert most_useful(forecast(mean, sd), ALL_WALK, NONE_TRIED, math.inf) == 80


def test_left_and_right_are_one() -> None:
    random = np.random.default_rng(4)
    some = forecast(random.uniform(-1, 1, 120), random.uniform(0.05, 0.3, 120), common=0.4)
    row = most_useful(some, ALL_WALK, NONE_TRIED, 0.3)
    assert most_useful(replace(some, mean_m=-some.mean_m), ALL_WALK, NONE_TRIED, 0.3) == row


def test_a_gait_that_tells_of_others_is_worth_more_than_its_twin_that_does_not() -> None:
    """Two gaits promise the same; what one shows narrows 40 others, of which one may then be on the line."""
    mean, sd = np.full(120, 1.5), np.full(120, 0.01)
    mean[:2], sd[:2] = 0.25, 0.2
    mean[2:42], sd[2:42] = np.linspace(-0.6, 0.6, 40), 0.2
    plain = forecast(mean, sd)
    covariance = plain.covariance_m2.copy()
    together = [1, *range(2, 42)]
    covariance[np.ix_(together, together)] = 0.95 * 0.2**2
    covariance[np.diag_indices(120)] = sd**2
    telling = replace(plain, covariance_m2=covariance)
    assert most_useful(telling, np.where(np.arange(120) < 2, 1.0, 0.9), NONE_TRIED, 0.5) != 0


@pytest.mark.parametrize("seed", range(3))
def test_the_most_promising_gait_has_the_greatest_gain_of_those_that_may_be_tried(seed: int) -> None:
    random = np.random.default_rng(seed)
    mean, sd = random.uniform(-1, 1, 120), random.uniform(0.05, 0.3, 120)
    walks, tried = random.uniform(0.5, 1.0, 120), random.uniform(size=120) < 0.3
    row = most_promising(forecast(mean, sd), walks, tried, 0.3)
    gains = expected_gain_m(mean, sd, 0.3) * walks
    assert not tried[row]
    assert gains[row] == gains[~tried].max()


@pytest.mark.parametrize("seed", range(3))
def test_the_gain_over_two_trials_is_what_chance_brings(seed: int) -> None:
    """Against Monte Carlo over a few gaits: first one, the belief narrowed, then the best second one."""
    random = np.random.default_rng(seed)
    mean, sd = np.full(120, 3.0), np.full(120, 1e-3)
    few = [3, 50, 99]
    mean[few], sd[few] = random.uniform(-0.5, 0.5, 3), random.uniform(0.1, 0.4, 3)
    some = forecast(mean, sd, common=0.6)
    gains = []
    for row in few:
        ends = mean[row] + sd[row] * np.random.default_rng(9).normal(size=20_000)
        pull = some.covariance_m2[:, row] / sd[row] ** 2
        left = np.sqrt(np.maximum(sd**2 - some.covariance_m2[:, row] ** 2 / sd[row] ** 2, 1e-8))
        best = np.minimum(0.5, np.abs(ends))
        others = [other for other in few if other != row]
        second = [
            expected_gain_m(mean[other] + pull[other] * (ends - mean[row]), np.full(1, left[other]), best)
            for other in others
        ]
        gains.append(float((0.5 - best + np.max(second, axis=0)).mean()))
    picked = most_useful(some, ALL_WALK, NONE_TRIED, math.inf)
    # Seven outcomes stand for all: what is picked is the best one, or as good as it.
    assert picked in few
    assert gains[few.index(picked)] >= max(gains) - 0.01


def test_the_expected_gain_is_that_of_a_normal_number() -> None:
    drawn = np.random.default_rng(0).normal(1.0, 0.5, 200_000)
    mean, sd = np.array([1.0, 1.0]), np.array([0.5, 1e-6])
    gain = expected_excess(0.8 - mean, sd)
    assert gain[0] == pytest.approx(np.maximum(0.8 - drawn, 0).mean(), rel=0.02)
    assert gain[1] == pytest.approx(0.0, abs=1e-9)
    assert expected_excess(0.8 - np.array([0.2]), np.array([1e-6]))[0] == pytest.approx(0.6)
