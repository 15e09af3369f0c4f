"""What standing still tells: against dense matrices, and where it should tell nothing."""

from dataclasses import replace

import numpy as np
import pytest

from hexctl.adapt.prior.belief import Belief
from hexctl.adapt.prior.prior import load_prior
from hexctl.adapt.prior.samples import FINAL, Samples, samples_of
from hexctl.adapt.prior.standing import narrowed
from hexctl.robot.configs import config_root
from hexctl.types import FloatArray
from tests.adapt.prior.dense import Dense
from tests.adapt.prior.test_belief import assert_agrees
from tests.adapt.priors import GAITS, MadeUpModel, standing_samples
from tests.robots import shipped

SHIPPED = config_root() / "priors" / "ant-locked-rear-30s.npz"
SAMPLES = standing_samples(MadeUpModel(), 12)
NOISE_M = 0.01


def sags(samples: Samples = SAMPLES) -> FloatArray:
    assert samples.sag_rad is not None
    return samples.sag_rad


def ordinary() -> FloatArray:
    """Return a sag that is no stranger than the worlds expect."""
    mean: FloatArray = sags().mean(axis=0)
    return np.asarray(mean + 0.7 * (sags()[3] - mean))


@pytest.mark.parametrize("trials", [0, 1, 4])
def test_it_agrees_with_dense_conditioning(trials: int) -> None:
    belief, dense = Belief(SAMPLES, noise_m=NOISE_M, sag_rad=ordinary()), Dense(SAMPLES, NOISE_M)
    dense.stand(ordinary())
    for code in range(1, trials + 1):
        # Nearly as believed, so that nothing is widened.
        features = dense.mean.reshape(GAITS, -1)[code - 1] + 1e-3
        belief.observe(code, features)
        dense.seen.append((code, features))
    forecast = belief.forecast()
    assert forecast.widened == 1.0
    assert_agrees(forecast, dense)


def test_a_world_is_known_by_its_stance() -> None:
    """A world of the prior, told only how it stands: the belief comes nearer to it and gets narrower."""
    before = Belief(SAMPLES, noise_m=NOISE_M).forecast()
    nearer = []
    for world, sag_rad in zip(SAMPLES.features, sags(), strict=True):
        after = Belief(SAMPLES, noise_m=NOISE_M, sag_rad=sag_rad).forecast()
        ends_m = world[:, FINAL]
        nearer.append(np.abs(after.mean_m - ends_m).mean() / np.abs(before.mean_m - ends_m).mean())
        assert (after.sd_m <= before.sd_m + 1e-9).all()
        assert after.sd_m.mean() < 0.8 * before.sd_m.mean()
    assert np.mean(nearer) < 0.6


def test_noise_of_the_sensors_leaves_more_than_half_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Worlds of the shipped prior, each left out, told how they stand."""
    exact = gain_m(noise_deg=0.0)
    noisy = gain_m(noise_deg=0.2)
    assert noisy > 0.5 * exact > 0
    monkeypatch.setattr("hexctl.adapt.prior.standing.RESOLUTION_RAD", 1e-9)
    assert noisy > 2 * gain_m(noise_deg=0.2), "what servos say was believed to the last digit"


def gain_m(*, noise_deg: float) -> float:
    """Return by how much nearer worlds are to what is believed of them once it is told how they stand."""
    samples = samples_of(load_prior(SHIPPED), shipped(), 5)
    random, gains_m = np.random.default_rng(0), []
    for row in range(0, len(samples.features), 5):
        others, ends_m = without(samples, row), samples.features[row][:, FINAL]
        read_rad = sags(samples)[row] + np.radians(random.normal(0, noise_deg, 18))
        gains_m.append(error_m(others, ends_m, None) - error_m(others, ends_m, read_rad))
    return float(np.mean(gains_m))


def error_m(samples: Samples, ends_m: FloatArray, sag_rad: FloatArray | None) -> float:
    """Return how far the final deviations of a world are from what is believed, over all gaits."""
    believed = Belief(samples, noise_m=NOISE_M, sag_rad=sag_rad).forecast()
    return float(np.abs(believed.mean_m - ends_m).mean())


def without(samples: Samples, row: int) -> Samples:
    """Return samples without one world."""
    assert samples.sag_rad is not None
    kept = np.arange(len(samples.features)) != row
    return replace(samples, features=samples.features[kept], sag_rad=samples.sag_rad[kept])


def test_what_no_world_explains_tells_little_and_narrows_little() -> None:
    shift, shrink = narrowed(sags(), sags().mean(axis=0) + 50 * sags().std(axis=0))
    assert np.linalg.norm(shift) < 2 * np.sqrt(len(shift))
    assert np.abs(shrink - np.eye(len(shift))).max() < 0.1


@pytest.mark.parametrize("joints", [[], [4], list(range(12, 15)), list(range(17))], ids=str)
def test_joints_that_do_not_say_are_left_out(joints: list[int]) -> None:
    silent, kept = ordinary(), [joint for joint in range(18) if joint not in joints]
    silent[joints] = np.nan
    with_gaps, without = narrowed(sags(), silent), narrowed(sags()[:, kept], ordinary()[kept])
    for got, wanted in zip(with_gaps, without, strict=True):
        np.testing.assert_allclose(got, wanted, atol=1e-12)


def test_a_world_in_which_the_robot_fell_is_told_nothing_of() -> None:
    fallen = sags().copy()
    fallen[5] = np.nan
    shift, shrink = narrowed(fallen, ordinary())
    assert shift[5] == pytest.approx(0.0)
    np.testing.assert_allclose(shrink[5], np.eye(len(shift))[5], atol=1e-12)
    others, _ = narrowed(np.delete(fallen, 5, axis=0), ordinary())
    np.testing.assert_allclose(np.delete(shift, 5), others, atol=1e-12)


@pytest.mark.parametrize(
    ("known", "seen"),
    [
        (np.full((4, 18), np.nan), np.zeros(18)),
        (np.full((4, 18), 0.1), np.zeros(18)),
        (sags(), np.full(18, np.nan)),
        (sags()[:1], np.zeros(18)),
    ],
    ids=["all fell", "all alike", "nobody says", "one world"],
)
def test_where_nothing_can_be_told_nothing_changes(known: FloatArray, seen: FloatArray) -> None:
    shift, shrink = narrowed(known, seen)
    np.testing.assert_array_equal(shift, np.zeros(len(known)))
    np.testing.assert_array_equal(shrink, np.eye(len(known)))


def test_wherever_the_failed_leg_is_locked_the_others_say_the_same() -> None:
    bent = ordinary()
    bent[12:15] += [0.5, -0.9, 1.2]
    one, other = (Belief(SAMPLES, noise_m=NOISE_M, sag_rad=sag).forecast() for sag in (ordinary(), bent))
    np.testing.assert_array_equal(one.mean_m, other.mean_m)
    np.testing.assert_array_equal(one.covariance_m2, other.covariance_m2)


def test_a_prior_that_knows_no_stances_believes_the_same() -> None:
    blind = replace(SAMPLES, sag_rad=None)
    told = Belief(blind, noise_m=NOISE_M, sag_rad=ordinary()).forecast()
    untold = Belief(SAMPLES, noise_m=NOISE_M).forecast()
    np.testing.assert_array_equal(told.mean_m, untold.mean_m)
    np.testing.assert_array_equal(told.covariance_m2, untold.covariance_m2)
