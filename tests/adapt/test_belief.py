"""The belief against dense conditioning, and which gait is walked next, against SciPy and integrals."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.adapt.prior.acquisition import (
    chance_above,
    chance_within,
    expected_gain_m,
    expected_size_m,
    most_useful,
)
from hexctl.adapt.prior.belief import (
    ALIKE_CYCLES,
    ALIKE_SHARE,
    BLUR,
    COMMON_SHARE,
    NEGLIGIBLE,
    NOISE,
    NOISE_WEIGHT,
    RESOLUTION_RAD,
    TRUST_TRIALS,
    UNEXPLAINED,
    Belief,
    Forecast,
    narrowed,
)
from hexctl.adapt.prior.samples import DISTANCE, FINAL, N_FEATURES, Samples
from hexctl.adapt.space import GaitSpace
from hexctl.types import FloatArray, leg_slice
from tests.adapt.priors import GAITS, MadeUpModel, standing_samples

Trial = tuple[int, FloatArray]


@dataclass
class Dense:
    """The joint normal of all gaits times features as one big matrix: an independent oracle."""

    samples: Samples
    noise_m: float
    widened: float = 1.0
    seen: list[Trial] = field(default_factory=list)

    def __post_init__(self) -> None:
        x = self.samples.features
        worlds = len(x)
        self.mean = x.mean(axis=0).ravel()
        apart = x - x.mean(axis=0)
        flat = apart.reshape(worlds, -1)
        pooled = apart.reshape(-1, N_FEATURES)
        self.shape = UNEXPLAINED * pooled.T @ pooled / len(pooled)
        distance = GaitSpace((self.samples.leg,)).phase_distance
        alike = COMMON_SHARE + ALIKE_SHARE * np.exp(-distance / ALIKE_CYCLES)
        alike[np.diag_indices(GAITS)] = 1.0
        spread = apart[..., FINAL].std(axis=0)
        spread = np.maximum(spread, max(np.median(spread) / 2, 1e-3))
        spread /= math.sqrt((spread**2).mean())
        alike *= np.outer(spread, spread)
        self.prior = flat.T @ flat / (worlds - 1) + np.kron(alike, self.shape)

    def stand(self, sag_rad: FloatArray) -> None:
        """Condition the worlds' part on a sag, (18,): joints by their spread, along what worlds share."""
        assert self.samples.sag_rad is not None
        failed = slice(3 * (self.samples.leg - 1), 3 * self.samples.leg)
        sags, sag_rad = (np.delete(array, failed, axis=-1) for array in (self.samples.sag_rad, sag_rad))
        spread = np.sqrt(sags.var(axis=0) + RESOLUTION_RAD**2)
        apart = (sags - sags.mean(axis=0)) / spread
        flat = (self.samples.features - self.samples.features.mean(axis=0)).reshape(len(sags), -1)
        variances, directions = np.linalg.eigh(apart.T @ apart / (len(sags) - 1))
        told = directions[:, variances > NEGLIGIBLE]
        across = flat.T @ apart @ told / (len(sags) - 1)
        among = told.T @ apart.T @ apart @ told / (len(sags) - 1) + NOISE * np.eye(told.shape[1])
        seen = told.T @ ((sag_rad - sags.mean(axis=0)) / spread)
        self.mean = self.mean + across @ np.linalg.solve(among, seen)
        self.prior = self.prior - across @ np.linalg.solve(among, across.T)

    def numbers(self) -> tuple[list[int], list[int], list[float]]:
        """Place, trial and value of every number seen."""
        places, trials, values = [], [], []
        for index, (code, features) in enumerate(self.seen):
            for feature in range(N_FEATURES):
                if not math.isnan(features[feature]):
                    places.append((code - 1) * N_FEATURES + feature)
                    trials.append(index)
                    values.append(float(features[feature]))
        return places, trials, values

    def posterior(self, feature: int) -> tuple[FloatArray, FloatArray]:
        """Mean and covariance of one feature of all gaits."""
        wanted = np.arange(GAITS) * N_FEATURES + feature
        prior = self.widened * self.prior
        places, trials, values = self.numbers()
        if not places:
            return self.mean[wanted], prior[np.ix_(wanted, wanted)]
        noisy = self._covariance(places, trials)
        across = prior[np.ix_(wanted, np.array(places))]
        mean = self.mean[wanted] + across @ np.linalg.solve(noisy, np.array(values) - self.mean[places])
        return mean, prior[np.ix_(wanted, wanted)] - across @ np.linalg.solve(noisy, across.T)

    def surprise(self) -> list[float]:
        """Error of each end in standard deviations, given all trials before it."""
        everything, found = self.seen, []
        for index, (code, features) in enumerate(everything):
            if math.isnan(features[FINAL]):
                continue
            end = np.full(N_FEATURES, np.nan)
            end[FINAL] = features[FINAL]
            self.seen = [*everything[:index], (code, end)]
            places, trials, values = self.numbers()
            covariance = self._covariance(places, trials)
            off = np.array(values) - self.mean[places]
            before, last = covariance[:-1, :-1], covariance[-1, :-1]
            mean = last @ np.linalg.solve(before, off[:-1]) if index else 0.0
            variance = covariance[-1, -1] - (last @ np.linalg.solve(before, last) if index else 0.0)
            found.append((off[-1] - mean) / math.sqrt(variance))
        self.seen = everything
        return [float(one) for one in found]

    def end_of_trial(self, code: int, features: FloatArray) -> tuple[float, float]:
        """Mean and standard deviation of the end of one walk that has shown some features so far."""
        everything = self.seen
        self.seen = [*everything, (code, features)]
        places, trials, values = self.numbers()
        self.seen = everything
        covariance = self._covariance([*places, (code - 1) * N_FEATURES + FINAL], [*trials, len(everything)])
        before, last = covariance[:-1, :-1], covariance[-1, :-1]
        weights = np.linalg.solve(before, last) if places else np.zeros(0)
        mean = self.mean[(code - 1) * N_FEATURES + FINAL] + weights @ (
            np.array(values) - self.mean[np.array(places, dtype=int)]
        )
        return float(mean), math.sqrt(covariance[-1, -1] - weights @ last)

    def _covariance(self, places: list[int], trials: list[int]) -> FloatArray:
        at = np.array(places, dtype=int)
        covariance: FloatArray = self.widened * self.prior[np.ix_(at, at)]
        features = at % N_FEATURES
        together = np.equal.outer(trials, trials)
        noise = self.shape[np.ix_(features, features)] * self.noise_m**2 / self.shape[FINAL, FINAL]
        covariance += np.where(together, noise, 0.0)
        blur = np.where(features == FINAL, 0.0, BLUR * np.diagonal(self.shape)[features])
        return np.asarray(covariance + np.diag(blur + 1e-9 * np.diagonal(covariance) + 1e-12))


MODEL = MadeUpModel()

SAMPLES = MODEL.samples(12)

NOISE_M = 0.01


def believed(trials: list[Trial], samples: Samples = SAMPLES) -> Belief:
    belief = Belief(samples, noise_m=NOISE_M)
    for code, features in trials:
        belief.observe(code, features)
    return belief


def ordinary(codes: list[int]) -> list[Trial]:
    """Trials in a world that is just as believed, or nearly: nothing is widened."""
    mean, some = SAMPLES.features.mean(axis=0), SAMPLES.features[3]
    return [(code, mean[code - 1] + 0.3 * (some - mean)[code - 1]) for code in codes]


def partly_blind(trials: list[Trial]) -> list[Trial]:
    """Trials of which some show only their beginning, or nothing but their end."""
    for index, (_, features) in enumerate(trials):
        if index % 3 == 1:
            features[4:FINAL] = np.nan
        if index % 3 == 2:
            features[5:] = np.nan
    return trials


def assert_agrees(forecast: Forecast, dense: Dense, tolerance: float = 1e-8) -> None:
    for feature, mean, spread in (
        (FINAL, forecast.mean_m, forecast.sd_m),
        (DISTANCE, forecast.distance_m, forecast.distance_sd_m),
    ):
        wanted, covariance = dense.posterior(feature)
        np.testing.assert_allclose(mean, wanted, atol=tolerance, rtol=0)
        np.testing.assert_allclose(spread**2, np.diagonal(covariance), atol=tolerance, rtol=0)
        if feature == FINAL:
            np.testing.assert_allclose(forecast.covariance_m2, covariance, atol=tolerance, rtol=0)


@pytest.mark.parametrize("codes", [[17], [17, 90], [1, 30, 77, 120, 64]], ids=str)
def test_it_agrees_with_dense_conditioning(codes: list[int]) -> None:
    trials = partly_blind(ordinary(codes))
    forecast = believed(trials).forecast()
    assert forecast.widened == 1.0
    assert_agrees(forecast, Dense(SAMPLES, NOISE_M, seen=trials))


@pytest.mark.parametrize("seed", range(4))
def test_it_agrees_with_dense_conditioning_when_worlds_surprise(seed: int) -> None:
    """By how much it is widened comes from each end against what was believed just before it."""
    (world,) = MODEL.worlds(1, 1000 + seed)
    trials = partly_blind([(code, world[code - 1]) for code in (5, 88, 31, 62)])
    for _, features in trials:
        features += 0.8 * (1 + seed)
    forecast = believed(trials).forecast()
    dense = Dense(SAMPLES, NOISE_M, seen=trials)
    surprise = dense.surprise()
    widened = (TRUST_TRIALS + sum(one**2 for one in surprise)) / (TRUST_TRIALS + len(surprise))
    assert forecast.widened == pytest.approx(max(1.0, widened), rel=1e-6)
    assert widened > 1
    assert_agrees(forecast, Dense(SAMPLES, NOISE_M, widened=forecast.widened, seen=trials), 1e-7)


def test_it_agrees_with_dense_conditioning_when_a_gait_is_repeated() -> None:
    trials = [*ordinary([40, 41]), *ordinary([40])]
    trials[2][1][FINAL] += 0.005
    forecast = believed(trials).forecast()
    assert forecast.widened == 1.0
    assert_agrees(forecast, Dense(SAMPLES, forecast.noise_m, seen=trials))


@pytest.mark.parametrize("shown", [0, 3, 6, 9])
@pytest.mark.parametrize("trials", [[], [12, 70], [33, 33]], ids=str)
def test_the_end_of_a_walk_that_is_on_its_way_agrees_with_dense_conditioning(
    trials: list[int], shown: int
) -> None:
    features = ordinary([33])[0][1]
    features[shown:] = np.nan
    belief = believed(ordinary(trials))
    noise_m = belief.forecast().noise_m
    mean_m, sd_m = belief.course_of(33).end(features)
    wanted_m, wanted_sd_m = Dense(SAMPLES, noise_m, seen=ordinary(trials)).end_of_trial(33, features)
    assert mean_m == pytest.approx(wanted_m, abs=1e-6)
    assert sd_m == pytest.approx(wanted_sd_m, abs=1e-6)


def repeated(*finals_m: float) -> Forecast:
    mean = SAMPLES.features.mean(axis=0)[49]
    trials = []
    for final_m in finals_m:
        features = np.full(N_FEATURES, np.nan)
        features[FINAL] = mean[FINAL] + final_m
        trials.append((50, features))
    return believed(trials).forecast()


def test_repeats_that_differ_raise_the_noise_and_equal_ones_lower_it() -> None:
    assert repeated().noise_m == pytest.approx(NOISE_M)
    assert repeated(0.0).noise_m == pytest.approx(NOISE_M)
    assert repeated(0.0, 0.0).noise_m == pytest.approx(NOISE_M * math.sqrt(NOISE_WEIGHT / (NOISE_WEIGHT + 1)))
    assert repeated(0.0, 0.0, 0.0).noise_m < repeated(0.0, 0.0).noise_m
    squares = NOISE_WEIGHT * NOISE_M**2 + 2 * 0.05**2
    assert repeated(-0.05, 0.05).noise_m == pytest.approx(math.sqrt(squares / (NOISE_WEIGHT + 1)))
    assert repeated(-0.05, 0.05, -0.05, 0.05).noise_m > repeated(-0.05, 0.05).noise_m > NOISE_M


def test_a_gait_that_always_fell_is_not_believed_to_be_certain() -> None:
    """Its numbers are all the same, because none was observed: that is ignorance."""
    features = SAMPLES.features.copy()
    features[:, 30] = features[:, 30].mean(axis=0)
    samples = replace(SAMPLES, features=features)
    forecast = believed([], samples).forecast()
    assert forecast.sd_m[30] > 0.1 * np.median(forecast.sd_m)
    assert_agrees(forecast, Dense(samples, NOISE_M))


STANDING = standing_samples(MODEL, 12)

SAGS: FloatArray = MODEL.sags(12, 0)

#: A sag that is no stranger than the worlds expect.
ORDINARY_SAG: FloatArray = SAGS.mean(axis=0) + 0.7 * (SAGS[3] - SAGS.mean(axis=0))


@pytest.mark.parametrize("trials", [0, 1, 4])
def test_a_stance_agrees_with_dense_conditioning(trials: int) -> None:
    belief, dense = Belief(STANDING, noise_m=NOISE_M, sag_rad=ORDINARY_SAG), Dense(STANDING, NOISE_M)
    dense.stand(ORDINARY_SAG)
    for code in range(1, trials + 1):
        # Nearly as believed, so that nothing is widened.
        features = dense.mean.reshape(GAITS, -1)[code - 1] + 1e-3
        belief.observe(code, features)
        dense.seen.append((code, features))
    forecast = belief.forecast()
    assert forecast.widened == 1.0
    assert_agrees(forecast, dense)


@pytest.mark.parametrize("joints", [[], [4], list(range(12, 15)), list(range(17))], ids=str)
def test_joints_that_do_not_say_are_left_out(joints: list[int]) -> None:
    silent, kept = ORDINARY_SAG.copy(), [joint for joint in range(18) if joint not in joints]
    silent[joints] = np.nan
    with_gaps, without = narrowed(SAGS, silent), narrowed(SAGS[:, kept], ORDINARY_SAG[kept])
    for got, wanted in zip(with_gaps, without, strict=True):
        np.testing.assert_allclose(got, wanted, atol=1e-12)


@pytest.mark.parametrize("worlds", [3, 12])
def test_a_world_in_which_the_robot_fell_is_told_nothing_of(worlds: int) -> None:
    fallen = SAGS[:worlds].copy()
    fallen[1] = np.nan
    shift, shrink = narrowed(fallen, ORDINARY_SAG)
    assert shift[1] == pytest.approx(0.0)
    np.testing.assert_allclose(shrink[1], np.eye(len(shift))[1], atol=1e-12)
    others, _ = narrowed(np.delete(fallen, 1, axis=0), ORDINARY_SAG)
    np.testing.assert_allclose(np.delete(shift, 1), others, atol=1e-12)
    assert others.any(), "two worlds are enough to tell"


@pytest.mark.parametrize(
    ("known", "seen"),
    [
        (np.full((4, 18), np.nan), np.zeros(18)),
        (np.full((4, 18), 0.1), np.zeros(18)),
        (SAGS, np.full(18, np.nan)),
        (SAGS[:1], np.zeros(18)),
    ],
    ids=["all fell", "all alike", "no joint measured", "one world"],
)
def test_where_nothing_can_be_told_nothing_changes(known: FloatArray, seen: FloatArray) -> None:
    shift, shrink = narrowed(known, seen)
    np.testing.assert_array_equal(shift, np.zeros(len(known)))
    np.testing.assert_array_equal(shrink, np.eye(len(known)))


def test_the_failed_legs_own_deflection_tells_only_where_it_is_not_known_what_broke() -> None:
    samples = replace(STANDING, failed_leg_tells=True)
    joints = leg_slice(samples.leg)
    hanging_rad = ORDINARY_SAG.copy()
    hanging_rad[joints] = SAGS[:, joints].mean(axis=0) + 2 * SAGS[:, joints].std(axis=0)

    def means_m(samples: Samples, sag_rad: FloatArray) -> FloatArray:
        return Belief(samples, noise_m=NOISE_M, sag_rad=sag_rad).forecast().mean_m

    np.testing.assert_array_equal(means_m(STANDING, hanging_rad), means_m(STANDING, ORDINARY_SAG))
    moved_m = means_m(samples, hanging_rad) - means_m(samples, ORDINARY_SAG)
    assert np.abs(moved_m).max() > 0.01


metres = st.floats(-2, 2)

spreads = st.floats(1e-3, 2)


def one(value: float) -> FloatArray:
    return np.array([value])


@given(mean=metres, sd=spreads, bound=st.floats(0, 2))
def test_chances_are_scipys(mean: float, sd: float, bound: float) -> None:
    from scipy.stats import norm

    within = norm.cdf(bound, mean, sd) - norm.cdf(-bound, mean, sd)
    assert chance_within(one(mean), one(sd), bound)[0] == pytest.approx(within, abs=1e-12)
    assert chance_above(one(mean), one(sd), bound)[0] == pytest.approx(norm.sf(bound, mean, sd), abs=1e-12)


@pytest.mark.parametrize(
    ("mean", "sd", "best"),
    [(0.3, 0.1, 0.05), (-0.3, 0.2, 0.4), (1.0, 0.01, 0.5), (-0.5, 1.0, 0.1), (0.0, 0.0005, 0.5)],
)
def test_the_expected_gain_is_its_integral(mean: float, sd: float, best: float) -> None:
    from scipy.integrate import quad
    from scipy.stats import norm

    wanted, _ = quad(
        lambda x: (best - abs(x)) * norm.pdf(x, mean, sd),
        -best,
        best,
        points=sorted({0.0, min(max(mean, -best), best)}),
        limit=500,
        epsabs=1e-12,
    )
    assert expected_gain_m(one(mean), one(sd), best)[0] == pytest.approx(wanted, abs=1e-9)


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
    from scipy.stats import foldnorm

    wanted = foldnorm.mean(abs(mean) / sd, scale=sd)
    assert expected_size_m(one(mean), one(sd))[0] == pytest.approx(wanted, abs=1e-9)
    assert expected_size_m(one(mean), one(sd))[0] >= abs(mean) - 1e-12


@given(seed=st.integers(0, 10_000), tried=st.integers(0, 119), best_m=st.sampled_from([math.inf, 0.3, 1e-3]))
def test_a_gait_that_was_tried_is_never_picked(seed: int, tried: int, best_m: float) -> None:
    random = np.random.default_rng(seed)
    rows = random.permutation(120)[:tried]
    known = np.isin(np.arange(120), rows)
    mean, sd = random.uniform(-1.5, 1.5, 120), random.uniform(0.001, 0.5, 120)
    mean[rows], sd[rows] = 0.0, 1e-5
    row = most_useful(forecast(mean, sd, common=0.3), random.uniform(0, 1, 120), known, best_m)
    assert not known[row]


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
    picked = most_useful(some, np.ones(120), np.zeros(120, dtype=bool), math.inf)
    # Seven outcomes stand for all: what is picked is the best one, or as good as it.
    assert picked in few
    assert gains[few.index(picked)] >= max(gains) - 0.01
