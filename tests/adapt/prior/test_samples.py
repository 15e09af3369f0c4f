"""A prior's worlds as samples of one leg's gaits: the leg's own, and turned or mirrored ones."""

from dataclasses import replace

import numpy as np
import pytest

from hexctl.adapt.prior.prior import CHECKPOINTS
from hexctl.adapt.prior.samples import (
    DISTANCE,
    FINAL,
    N_FEATURES,
    YAW,
    Samples,
    features_of,
    samples_of,
    serves,
)
from hexctl.adapt.prior.symmetry import Symmetries
from hexctl.adapt.shown import Shown
from hexctl.errors import InputError
from hexctl.types import FloatArray
from tests.adapt.priors import MadeUpModel, made_up_prior, question_of, shown_of
from tests.robots import shipped

ROW = 41  # of code 42


def rows_like(samples: Samples, features: FloatArray) -> int:
    """Return how many of the samples are these worlds' features, gait for gait."""
    return sum(
        all(np.abs(one - own).max() < 1e-12 for one, own in zip(block, features, strict=True))
        for block in np.split(samples.features, len(samples.features) // len(features))
    )


def test_own_worlds_come_first_and_as_they_are() -> None:
    prior = made_up_prior(legs=(5,), worlds=3)
    samples = samples_of(prior, shipped("pexod"), 5)
    assert samples.leg == 5
    assert samples.features.shape == (3, 120, N_FEATURES)
    np.testing.assert_allclose(samples.features[..., : FINAL + 1], prior.signed_m[0], rtol=1e-9)
    np.testing.assert_allclose(samples.features[..., DISTANCE - 1], prior.progress_m[0][..., 4], rtol=1e-9)
    np.testing.assert_allclose(samples.features[..., DISTANCE], prior.progress_m[0][..., -1], rtol=1e-9)
    np.testing.assert_allclose(samples.features[..., YAW], prior.yaw_rad[0], rtol=1e-9)
    np.testing.assert_array_equal(samples.finished, np.ones(120))


def test_all_legs_of_ant_serve_each_leg_in_both_mirrors() -> None:
    prior = made_up_prior(legs=(1, 2, 3, 4, 5, 6), worlds=2)
    for leg in range(1, 7):
        assert samples_of(prior, shipped(), leg).features.shape[0] == 2 * 6 * 2


@pytest.mark.parametrize(("name", "legs", "leg", "worlds"), [
    ("ant", (5,), 5, 6), ("ant", (2,), 5, 6), ("phantomx", (2, 5), 5, 12), ("phantomx", (1,), 6, 3),
    ("pexod", (2,), 5, 3), ("pexod", (2, 5), 5, 6),
])  # fmt: skip
def test_symmetries_bring_the_worlds_of_other_legs(
    name: str, legs: tuple[int, ...], leg: int, worlds: int
) -> None:
    prior = made_up_prior(question_of(shipped(name)), legs=legs, worlds=3)
    assert len(samples_of(prior, shipped(name), leg).features) == worlds


@pytest.mark.parametrize("name", ["ant", "phantomx", "pexod"])
@pytest.mark.parametrize("leg", [2, 5])
def test_a_moved_gait_takes_its_numbers_with_it(name: str, leg: int) -> None:
    """Each source gait is found again at the code that the symmetry gives it, with signs as in a mirror."""
    prior = made_up_prior(question_of(shipped(name)), legs=(2,), worlds=2)
    own = samples_of(prior, shipped(name), 2).features[:2]
    samples = samples_of(prior, shipped(name), leg)
    flipped = own.copy()
    flipped[..., [*range(CHECKPOINTS), YAW]] *= -1
    expected = []
    for symmetry in Symmetries(shipped(name)).all:
        if symmetry.legs[1] == leg:
            moved = np.empty_like(own)
            for code in range(1, 121):
                moved[:, symmetry.codes(2)[code - 1] - 1] = (flipped if symmetry.mirrored else own)[
                    :, code - 1
                ]
            expected.append(moved)
    assert len(expected) * 2 == len(samples.features)
    assert [rows_like(samples, one) for one in expected] == [1] * len(expected)


def test_a_leg_that_nothing_says_anything_about_is_refused() -> None:
    prior = made_up_prior(question_of(shipped("pexod")), legs=(1, 6))
    with pytest.raises(InputError, match=r"prior: got failed leg 2; allowed: 1, 6"):
        samples_of(prior, shipped("pexod"), 2)


def with_falls(worlds: int, fallen: tuple[int, ...], from_checkpoint: int = 4) -> Samples:
    """Return samples of pexod's leg 5, in some worlds of which one gait fell on its way."""
    prior = made_up_prior(worlds=worlds)
    for world in fallen:
        prior.signed_m[0, world, ROW, from_checkpoint:] = np.nan
        prior.progress_m[0, world, ROW, from_checkpoint:] = np.nan
        prior.yaw_rad[0, world, ROW] = np.nan
    return samples_of(prior, shipped("pexod"), 5)


def test_without_self_rotation_only_the_mirror_along_the_way_serves() -> None:
    """Turned by 60 degrees leg 5 of ant would be leg 4, but the robot would walk to its side."""
    question = question_of(self_rotation="none")
    prior = made_up_prior(question, legs=(2, 5), worlds=2)
    assert len(samples_of(prior, shipped(), 5).features) == 2
    assert len(samples_of(prior, shipped(), 6).features) == 2
    for leg in (1, 4, 3):
        served = leg == 3
        assert serves(shipped(), "none", (2, 5), leg) == served
        if not served:
            with pytest.raises(InputError, match=f"got failed leg {leg}; allowed: 2, 5"):
                samples_of(prior, shipped(), leg)
    assert all(serves(shipped(), "rear", (2,), leg) for leg in range(1, 7))


def test_a_leg_that_fell_with_every_gait_tells_nothing() -> None:
    prior = made_up_prior(worlds=2)
    prior.signed_m[..., 4:] = np.nan
    with pytest.raises(InputError, match="leg 5 fell with every gait in every world"):
        samples_of(prior, shipped(), 5)


def test_what_fallen_robots_did_not_show_is_the_mean_of_those_that_walked() -> None:
    whole, samples = with_falls(4, ()), with_falls(4, (1,))
    assert np.isfinite(samples.features).all()
    assert samples.finished[ROW] == pytest.approx(0.75)
    assert samples.finished.sum() == pytest.approx(119.75)
    others = whole.features[[0, 2, 3], ROW]
    np.testing.assert_allclose(samples.features[1, ROW, 4:CHECKPOINTS], others[:, 4:CHECKPOINTS].mean(axis=0))
    np.testing.assert_allclose(samples.features[1, ROW, YAW], others[:, YAW].mean())
    # What it did show is kept, and so is everything else.
    np.testing.assert_allclose(samples.features[1, ROW, :4], whole.features[1, ROW, :4])
    np.testing.assert_allclose(np.delete(samples.features, ROW, 1), np.delete(whole.features, ROW, 1))


def test_a_gait_that_seldom_walks_is_believed_to_spread_as_those_walks_did() -> None:
    whole, samples = with_falls(8, ()), with_falls(8, (1, 3, 4, 5, 6))
    walked = whole.features[[0, 2, 7], ROW, FINAL]
    assert samples.features[:, ROW, FINAL].mean() == pytest.approx(walked.mean())
    assert samples.features[:, ROW, FINAL].std() == pytest.approx(walked.std())


def test_a_gait_that_always_falls_is_no_number_that_is_none() -> None:
    samples = with_falls(3, (0, 1, 2), from_checkpoint=0)
    assert samples.finished[ROW] == 0
    assert np.isfinite(samples.features).all()


def test_a_walk_shows_deviation_on_its_way_progress_twice_and_yaw() -> None:
    steps = np.arange(1, 101)
    path = np.column_stack([steps * 0.1, -steps * 0.01])
    shown = Shown(path_m=path, duration_s=20.0, yaw_change_rad=0.3, status="ok")
    features = features_of(shown, 20.0)
    np.testing.assert_allclose(features[: FINAL + 1], -0.1 * np.arange(1, 11))
    np.testing.assert_allclose(features[-3:], [5.0, 10.0, 0.3])


def test_the_last_point_of_a_walk_is_its_end() -> None:
    path = np.random.default_rng(0).normal(size=(1500, 2))
    for length in (1500, 250, 151, 37, 10):
        shown = Shown(path_m=path[:length], duration_s=30.0, yaw_change_rad=0.0, status="ok")
        features = features_of(shown, 30.0)
        assert features[FINAL] == path[length - 1, 1]
        assert features[DISTANCE] == path[length - 1, 0]


def test_a_walk_that_was_cut_short_shows_its_beginning() -> None:
    path = np.column_stack([np.arange(1, 41) * 0.1, np.arange(1, 41) * 0.01])
    features = features_of(
        Shown(path_m=path, duration_s=8.0, yaw_change_rad=0.1, status="cut_short"), duration_s=20.0
    )
    np.testing.assert_allclose(features[:4], [0.1, 0.2, 0.3, 0.4])
    assert np.isnan(features[4:]).all()


def test_a_robot_that_fell_does_not_show_its_yaw_nor_its_end() -> None:
    model = MadeUpModel().worlds(1, 0)[0, 0]
    fell = features_of(shown_of(model, "fell"), 30.0)
    assert np.isnan(fell[YAW])
    half = replace(shown_of(model, "fell"), path_m=shown_of(model).path_m[:5], duration_s=15.0)
    features = features_of(half, 30.0)
    assert np.isfinite(features[:5]).all()
    assert np.isnan(features[5:CHECKPOINTS]).all()
    assert np.isfinite(features[DISTANCE - 1])
    assert np.isnan(features[DISTANCE])


def test_a_simulation_that_diverged_shows_nothing() -> None:
    features = features_of(shown_of(MadeUpModel().worlds(1, 0)[0, 0], "diverged"), 30.0)
    assert np.isnan(features).all()


def test_a_walk_without_progress_shows_everything() -> None:
    features = features_of(shown_of(MadeUpModel().worlds(1, 0)[0, 0], "no_progress"), 30.0)
    assert np.isfinite(features).all()


def test_a_robot_that_never_walked_shows_nothing() -> None:
    shown = Shown(path_m=np.zeros((0, 2)), duration_s=0.0, yaw_change_rad=None, status="fell")
    assert np.isnan(features_of(shown, 30.0)).all()


def test_made_up_walks_show_what_they_were_made_from() -> None:
    """The helper of these tests keeps to the same checkpoints."""
    for features in MadeUpModel().worlds(1, 3)[0, :5]:
        np.testing.assert_allclose(features_of(shown_of(features), 30.0), features)
