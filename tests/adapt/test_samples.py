"""The symmetries of the shipped robots, and the samples that a prior gives one leg."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from hexctl.adapt.optimizer import Observation
from hexctl.adapt.prior.prior import CHECKPOINTS, SCORES
from hexctl.adapt.prior.samples import (
    DISTANCE,
    YAW,
    Samples,
    features_of,
    moved_codes,
    samples_of,
    score_samples_of,
)
from hexctl.adapt.space import GaitSpace
from hexctl.backends.sim.world import World
from hexctl.control.body_symmetry import BodySymmetry, body_symmetries
from hexctl.errors import InputError
from hexctl.study.landscape import LandscapeSpec
from hexctl.study.priors.prior_building import deflection_of
from hexctl.types import FloatArray
from tests.adapt.priors import MadeUpModel, key_of, made_up_prior, made_up_score_prior, shown_of
from tests.robots import ROBOT_NAMES, shipped

LEGS = range(1, 7)


@cache
def symmetries(name: str) -> tuple[BodySymmetry, ...]:
    return body_symmetries(shipped(name))


def each() -> list[BodySymmetry]:
    return list(dict.fromkeys(symmetry for name in ROBOT_NAMES for symmetry in symmetries(name)))


def ids(value: object) -> str:
    return f"{value.legs}{'m' if value.mirrored else ''}" if isinstance(value, BodySymmetry) else str(value)


@pytest.mark.parametrize("symmetry", each(), ids=ids)
def test_a_moved_gait_has_the_same_lags_between_the_moved_legs(symmetry: BodySymmetry) -> None:
    for leg in LEGS:
        before, after = GaitSpace((leg,)), GaitSpace((symmetry.legs[leg - 1],))
        moved = after.slots[moved_codes(symmetry, leg) - 1][:, np.array(symmetry.legs) - 1]
        shifts = (moved - before.slots) % 6
        np.testing.assert_array_equal(shifts, shifts[:, :1] * np.ones((1, 6), dtype=int))


WORLD = World(
    slope_deg=1.5,
    slope_direction_deg=50.0,
    body_mass_shift_m=(0.01, 0.012, -0.004),
    joint_offset_deg=tuple(np.random.default_rng(3).normal(0, 1, 18).round(2).tolist()),
    added_mass_share=0.1,
    friction=0.7,
)


def mirrored(world: World, symmetry: BodySymmetry) -> World:
    """A world as it is seen in a mirror along the line of travel."""
    assert isinstance(world.joint_offset_deg, tuple)
    offsets: FloatArray = np.empty((6, 3))
    offsets[np.array(symmetry.legs) - 1] = np.array(world.joint_offset_deg).reshape(6, 3) * [-1, 1, 1]
    x, y, z = world.body_mass_shift_m
    return world.model_copy(
        update={
            "slope_direction_deg": -world.slope_direction_deg,
            "body_mass_shift_m": (x, -y, z),
            "joint_offset_deg": tuple(offsets.ravel().tolist()),
        }
    )


def standing(world: World, leg: int) -> FloatArray:
    return deflection_of(LandscapeSpec(robot=shipped(), world=world, leg=leg, self_rotation="rear"))


def test_a_mirrored_world_gives_the_mirrored_stance() -> None:
    (symmetry,) = [one for one in symmetries("ant") if one.mirrored and one.keeps_heading]
    true, seen = standing(WORLD, 2), standing(mirrored(WORLD, symmetry), symmetry.legs[1])
    np.testing.assert_allclose(symmetry.joints(true), seen, atol=1e-6)
    assert np.abs(true - seen).max() > 1e-3, "the mirror is no formality"


ROW = 41  # of code 42


def rows_like(samples: Samples, features: FloatArray) -> int:
    """Number of samples that are these worlds' features, gait for gait."""
    return sum(
        all(np.abs(one - own).max() < 1e-12 for one, own in zip(block, features, strict=True))
        for block in np.split(samples.features, len(samples.features) // len(features))
    )


@pytest.mark.parametrize("name", ["ant", "phantomx", "pexod"])
@pytest.mark.parametrize("leg", [2, 5])
def test_a_moved_gait_takes_its_numbers_with_it(name: str, leg: int) -> None:
    """Each source gait is found again at the code that the symmetry gives it, with signs as in a mirror."""
    prior = made_up_prior(key_of(shipped(name)), legs=(2,), worlds=2)
    own = samples_of(prior, shipped(name), 2).features[:2]
    samples = samples_of(prior, shipped(name), leg)
    flipped = own.copy()
    flipped[..., [*range(CHECKPOINTS), YAW]] *= -1
    expected = []
    for symmetry in body_symmetries(shipped(name)):
        if symmetry.legs[1] == leg:
            moved = np.empty_like(own)
            moved[:, moved_codes(symmetry, 2) - 1] = flipped if symmetry.mirrored else own
            expected.append(moved)
    assert len(expected) * 2 == len(samples.features)
    assert [rows_like(samples, one) for one in expected] == [1] * len(expected)


def with_falls(worlds: int, fallen: tuple[int, ...], from_checkpoint: int = 4) -> Samples:
    """Samples of pexod's leg 5, in some worlds of which one gait fell on its way."""
    prior = made_up_prior(worlds=worlds)
    for world in fallen:
        prior.signed_m[0, world, ROW, from_checkpoint:] = np.nan
        prior.progress_m[0, world, ROW, from_checkpoint:] = np.nan
        prior.yaw_rad[0, world, ROW] = np.nan
    return samples_of(prior, shipped("pexod"), 5)


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


def test_scores_of_a_leg_are_its_own_and_those_of_its_mirror_image() -> None:
    prior = made_up_score_prior(legs=(2, 5), worlds=3)
    own = score_samples_of(prior, shipped("pexod"), 2, "tilt")
    assert own.log_scores.shape == (6, 120)
    np.testing.assert_array_equal(own.log_scores[:3], prior.log_scores[0, :, :, SCORES.index("tilt")])
    mirror = next(one for one in body_symmetries(shipped("pexod")) if one.mirrored and one.keeps_heading)
    assert mirror.legs[5 - 1] == 2
    moved = own.log_scores[3:, moved_codes(mirror, 5) - 1]
    np.testing.assert_array_equal(moved, prior.log_scores[1, :, :, SCORES.index("tilt")])


def test_what_never_walked_scores_as_the_worst_and_what_sometimes_fell_as_elsewhere() -> None:
    prior = made_up_score_prior(legs=(3,), worlds=2)
    scores, valid = prior.log_scores.copy(), prior.valid.copy()
    scores[0, :, 6] = np.nan
    scores[0, 1, 8], valid[0, :, 6], valid[0, 1, 8] = np.nan, False, False
    samples = score_samples_of(replace(prior, log_scores=scores, valid=valid), shipped("pexod"), 3, "speed")
    assert np.isfinite(samples.log_scores).all()
    assert samples.log_scores[:, 6].min() == samples.log_scores.mean(axis=0).max()
    assert samples.log_scores[1, 8] == scores[0, 0, 8, 0]
    assert (samples.valid[6], samples.valid[8], samples.valid[0]) == (0.0, 0.5, 1.0)


def test_what_a_leg_or_an_objective_is_not_known_of_is_refused() -> None:
    with pytest.raises(InputError, match="prior"):
        samples_of(made_up_prior(key_of(shipped("pexod")), legs=(1, 6)), shipped("pexod"), 2)
    fallen = made_up_prior(worlds=2)
    fallen.signed_m[..., 4:] = np.nan
    with pytest.raises(InputError, match="leg 5"):
        samples_of(fallen, shipped(), 5)
    scores = made_up_score_prior(legs=(3,))
    nowhere = replace(scores, log_scores=np.full_like(scores.log_scores, np.nan))
    for prior, leg, objective, field in (
        (scores, 2, "speed", "prior"), (scores, 3, "final", "objective"), (nowhere, 3, "speed", "leg 3"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=field):
            score_samples_of(prior, shipped("pexod"), leg, objective)


def test_walks_without_progress_show_all_and_those_that_diverged_or_never_began_nothing() -> None:
    features = MadeUpModel().worlds(1, 0)[0, 0]
    assert np.isfinite(features_of(shown_of(features, "no_progress"), 30.0)).all()
    assert np.isnan(features_of(shown_of(features, "diverged"), 30.0)).all()
    never = Observation(path_m=np.zeros((0, 2)), duration_s=0.0, yaw_change_rad=None, status="fell")
    assert np.isnan(features_of(never, 30.0)).all()
