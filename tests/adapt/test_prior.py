"""A prior's file and key, how a session finds its prior, and the samples that it gives one leg."""

import itertools
import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.adapt.optimizer import Observation
from hexctl.adapt.prior.prior import (
    CHECKPOINTS,
    SCORES,
    Prior,
    PriorKey,
    ScorePrior,
    load_prior,
    load_score_prior,
    open_prior,
    save_prior,
)
from hexctl.adapt.prior.prior_files import (
    check_prior,
    find_prior,
    shipped_priors,
)
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
from hexctl.archive import ArchiveFileError
from hexctl.backends.sim.world import World
from hexctl.control.body_symmetry import BodySymmetry, body_symmetries
from hexctl.errors import InputError
from hexctl.robot.failure import Failure
from hexctl.robot.loader import load_robot
from hexctl.study.landscape import LandscapeSpec
from hexctl.study.priors.prior_building import deflection_of
from hexctl.types import FloatArray
from tests.adapt.priors import (
    MadeUpModel,
    key_of,
    made_up_prior,
    made_up_score_prior,
    plan_of,
    shown_of,
)
from tests.robots import ROBOT_NAMES, edited_file, put, shipped

ARRAYS = ("signed_m", "progress_m", "yaw_rad", "sag_rad")


@cache
def prior_with_a_fall() -> Prior:
    prior = made_up_prior(legs=(2, 5), worlds=2)
    for array in (prior.signed_m, prior.progress_m):
        array[1, 0, 7, 4:] = np.nan
    prior.yaw_rad[1, 0, 7] = np.nan
    sag_rad = np.random.default_rng(8).normal(0.0, 0.05, (2, 2, 18))
    sag_rad[0, 1] = np.nan  # did not stay on its legs
    return replace(prior, sag_rad=sag_rad)


@cache
def small_prior() -> Prior:
    """A prior whose file is a few kB."""
    prior = made_up_prior(worlds=1)
    return replace(
        prior,
        signed_m=np.round(prior.signed_m[:, :, :1] * np.ones((1, 1, 120, 1)), 1),
        progress_m=np.round(prior.progress_m[:, :, :1] * np.ones((1, 1, 120, 1)), 1),
        yaw_rad=np.zeros((1, 1, 120)),
        sag_rad=np.full((1, 1, 18), 0.02),
    )


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "some.npz"
    save_prior(prior_with_a_fall(), path)
    return path


def refusal(path: Path) -> str:
    with pytest.raises(InputError) as refused:
        load_prior(path)
    message = str(refused.value)
    assert "\n" not in message
    assert path.name in message
    assert "; allowed: " in message
    return message


def same(one: Prior, other: Prior) -> bool:
    return one.head == other.head and all(
        np.array_equal(getattr(one, name), getattr(other, name), equal_nan=True) for name in ARRAYS
    )


def test_a_prior_comes_back_as_it_went(path: Path) -> None:
    prior, loaded = prior_with_a_fall(), load_prior(path)
    assert loaded.head == prior.head
    assert (loaded.worlds, loaded.legs, loaded.key) == (2, (2, 5), key_of())
    for name in ARRAYS:
        got, wanted = getattr(loaded, name), getattr(prior, name)
        assert got.dtype == np.float64
        np.testing.assert_array_equal(np.isnan(got), np.isnan(wanted))
        # Half precision: 2 mm at 4 m, and finer nearer to the line.
        np.testing.assert_allclose(got, wanted, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("share", [0.001, 0.5, 0.999])
def test_a_file_that_is_cut_off_is_refused(share: float, path: Path) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    assert "cut off" in refusal(path)


def write(path: Path, head: Any, **arrays: Any) -> None:
    """Write a file of a prior's form, whatever is in it."""
    text = head if isinstance(head, str) else json.dumps(head)
    np.savez_compressed(path, allow_pickle=False, head=np.array(text), **arrays)


def parts_of(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    with np.load(path) as file:
        return json.loads(str(file["head"])), {name: file[name] for name in ARRAYS}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"version": 3}, "it has version 3, this hexctl reads 1 and 2"),
        ({"format": "hexctl landscape"}, "it is not a prior"),
        ({"digest": "0" * 32}, "altered"),
        ({"legs": [2, 3]}, "altered"),
        ({"question": None}, "damaged"),
    ],
    ids=str,
)
def test_a_head_that_is_another_is_refused(change: dict[str, Any], words: str, path: Path) -> None:
    head, arrays = parts_of(path)
    write(path, {**head, **change}, **arrays)
    assert words in refusal(path)


@pytest.mark.parametrize("name", ARRAYS)
def test_numbers_that_do_not_fit_are_refused(name: str, path: Path) -> None:
    head, arrays = parts_of(path)
    for other in (arrays[name][:, :1], arrays[name][..., :9], np.float16(1.0), np.zeros(3)):
        write(path, head, **{**arrays, name: other})
        assert "damaged" in refusal(path)
    del arrays[name]
    write(path, head, **arrays)
    assert ("altered" if name == "sag_rad" else "damaged") in refusal(path)


@pytest.mark.long
def test_no_byte_can_be_changed_unnoticed(tmp_path: Path) -> None:
    """Each byte, changed in four ways: the file is refused in one line, or holds what it held before."""
    path = tmp_path / "some.npz"
    save_prior(small_prior(), path)
    prior, content = load_prior(path), path.read_bytes()
    random = np.random.default_rng(0)
    failed: list[tuple[int, int, str]] = []
    for place in range(len(content)):
        changes = {1 << int(random.integers(8)), int(random.integers(1, 256)), 0xFF, 1}
        for value in sorted(content[place] ^ change for change in changes):
            path.write_bytes(content[:place] + bytes([value]) + content[place + 1 :])
            try:
                if not same(load_prior(path), prior):
                    failed.append((place, value, "silently another prior"))
            except InputError as error:
                if "\n" in str(error):
                    failed.append((place, value, "refused in several lines"))
            except Exception as error:  # noqa: BLE001  that is what is looked for
                failed.append((place, value, repr(error)))
    assert failed == []


def test_a_place_that_is_none_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "a-file").touch()
    with pytest.raises(ArchiveFileError, match=r"^prior: .*new.npz cannot be written: .*\Z"):
        save_prior(small_prior(), tmp_path / "a-file" / "new.npz")


def test_the_same_robot_with_another_description_is_another_question(tmp_path: Path) -> None:
    heavier = load_robot(str(edited_file(tmp_path, put("body", "mass_kg", 3.0))))
    assert key_of().differences(key_of(heavier)) == ["another description of ant"]


def test_each_kind_of_prior_is_read_as_what_it_is_and_the_other_is_refused_by_name(tmp_path: Path) -> None:
    ends, scores = tmp_path / "ends.npz", tmp_path / "scores.npz"
    save_prior(small_prior(), ends)
    save_prior(made_up_score_prior(), scores)
    assert isinstance(open_prior(ends), Prior)
    assert isinstance(open_prior(scores), ScorePrior)
    with pytest.raises(InputError, match=r"scores.npz: it is of steered walks \(hold line\), not of where"):
        load_prior(scores)
    with pytest.raises(InputError, match=r"ends.npz: it is of where open-loop walks end, not of steered"):
        load_score_prior(ends)


def save(folder: Path, name: str, question: PriorKey) -> Path:
    path = folder / name
    save_prior(made_up_prior(question, worlds=1), path)
    return path


def test_files_that_are_no_priors_are_passed_over(path: Path, tmp_path: Path) -> None:
    (tmp_path / "a.npz").write_text("my diary")
    (tmp_path / "b.npz").touch()
    np.savez(tmp_path / "c.npz", a=np.arange(3))
    (tmp_path / "d.npz").mkdir()
    cut = save(tmp_path, "e.npz", key_of())
    cut.write_bytes(cut.read_bytes()[:-200])
    (tmp_path / "f.npz").symlink_to(tmp_path / "gone")
    head, arrays = parts_of(path)
    odd = {**head, "question": {**head["question"], "weather": "rain"}}
    write(tmp_path / "g.npz", odd, **arrays)
    with pytest.raises(InputError, match="it is damaged"):
        check_prior(tmp_path / "g.npz", shipped(), plan_of(shipped()))
    path.unlink()
    fits = save(tmp_path, "h.npz", key_of())
    assert find_prior(shipped(), plan_of(shipped()), [tmp_path]).path == fits
    fits.unlink()
    assert find_prior(shipped(), plan_of(shipped()), [tmp_path]).path is None


def test_the_reason_names_the_nearest(tmp_path: Path) -> None:
    save(tmp_path, "a.npz", key_of(shipped("phantomx"), duration_s=12.0))
    save(tmp_path, "b.npz", key_of(duration_s=12.0))
    save(tmp_path, "c.npz", key_of(duration_s=12.0, self_rotation="none"))
    found = find_prior(shipped(), plan_of(shipped()), [tmp_path])
    assert found.path is None
    assert found.reason == "b.npz is for duration 12 s, not 30 s"


def test_a_prior_of_other_legs_is_passed_over_and_named(tmp_path: Path) -> None:
    robot = shipped("pexod")
    question = key_of(robot, failure=Failure(leg=2))
    save_prior(made_up_prior(question, legs=(1, 6), worlds=1), tmp_path / "a.npz")
    plan = plan_of(robot, failure=Failure(leg=2))
    found = find_prior(robot, plan, [tmp_path])
    assert (found.path, found.reason) == (None, "a.npz is for failed leg 1, 6")
    with pytest.raises(InputError, match="is for failed leg 1, 6; allowed: a prior for the same trials"):
        check_prior(tmp_path / "a.npz", robot, plan)
    save_prior(made_up_prior(question, legs=(5,), worlds=1), tmp_path / "b.npz")
    assert find_prior(robot, plan, [tmp_path]).path == tmp_path / "b.npz"


@pytest.mark.parametrize("path", sorted(shipped_priors().glob("*.npz")), ids=lambda path: path.name)
def test_a_shipped_prior_is_whole_small_and_for_the_shipped_robot(path: Path) -> None:
    prior = open_prior(path)
    assert prior.key.robot in ROBOT_NAMES
    robot = shipped(prior.key.robot)
    assert path.name.startswith(f"{robot.name}-")
    asked = key_of(robot, duration_s=prior.key.duration_s)
    usual: dict[str, Any] = {"failure": "locked", "self_rotation": "rear", "hold": "none"}
    assert replace(prior.key, posture="stance", **usual).differences(asked) == []
    assert path.stat().st_size < 1_500_000
    for leg in range(1, 7):
        if isinstance(prior, ScorePrior):
            scores = score_samples_of(prior, robot, leg, "speed")
            assert len(scores.log_scores) == 2 * prior.worlds
            assert scores.valid.mean() > 0.5
            assert 5 < np.exp(scores.log_scores.mean()) < 15  # s/m
            continue
        samples = samples_of(prior, robot, leg)
        assert len(samples.features) >= 2
        assert samples.finished.mean() > 0.5
        assert np.abs(samples.features).max() < 20


#: Pairs of options of two questions, and how the second differs from the first.
DIFFERENCES: list[tuple[dict[str, Any], dict[str, Any], list[str]]] = [
    ({}, {}, []),
    ({}, {"failure": Failure(leg=2)}, []),  # the failed leg points to the rear of wherever it goes
    ({}, {"heading_rad": 1.0}, []),
    ({}, {"duration_s": 12.5}, ["duration 30 s, not 12.5 s"]),
    (
        {"failure": Failure(leg=5, kind="weak", torque_fraction=0.5)},
        {"failure": Failure(leg=5, kind="weak", torque_fraction=0.25)},
        ["failure weak:0.5, not weak:0.25"],
    ),
    (
        {"self_rotation": "none"},
        {"self_rotation": "none", "heading_rad": math.pi / 2},  # the body does not turn to where it goes
        ["heading 0 deg, not 90 deg"],
    ),
]


@pytest.mark.parametrize(("one", "other", "differences"), DIFFERENCES, ids=str)
def test_another_question_is_named_with_both_values(
    one: dict[str, Any], other: dict[str, Any], differences: list[str]
) -> None:
    assert key_of(**one).differences(key_of(**other)) == differences


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_a_moved_gait_has_the_same_lags_between_the_moved_legs(name: str) -> None:
    for symmetry, leg in itertools.product(body_symmetries(shipped(name)), range(1, 7)):
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
    (symmetry,) = [one for one in body_symmetries(shipped()) if one.mirrored and one.keeps_heading]
    true, seen = standing(WORLD, 2), standing(mirrored(WORLD, symmetry), symmetry.legs[1])
    np.testing.assert_allclose(symmetry.joints(true), seen, atol=1e-6)
    assert np.abs(true - seen).max() > 1e-3, "the mirror is no formality"


#: The row of code 42.
ROW = 41


def rows_like(samples: Samples, features: FloatArray) -> int:
    """Number of samples that are these worlds' features, gait for gait."""
    return sum(
        all(np.abs(one - own).max() < 1e-12 for one, own in zip(block, features, strict=True))
        for block in np.split(samples.features, len(samples.features) // len(features))
    )


@pytest.mark.parametrize("name", ROBOT_NAMES)
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


def test_what_fallen_robots_did_not_show_is_the_mean_of_those_that_walked() -> None:
    prior = made_up_prior(worlds=4)
    whole = samples_of(prior, shipped("pexod"), 5)
    for array in (prior.signed_m, prior.progress_m):
        array[0, 1, ROW, 4:] = np.nan
    prior.yaw_rad[0, 1, ROW] = np.nan
    samples = samples_of(prior, shipped("pexod"), 5)
    assert np.isfinite(samples.features).all()
    assert samples.finished[ROW] == pytest.approx(0.75)
    assert samples.finished.sum() == pytest.approx(119.75)
    others = whole.features[[0, 2, 3], ROW]
    np.testing.assert_allclose(samples.features[1, ROW, 4:CHECKPOINTS], others[:, 4:CHECKPOINTS].mean(axis=0))
    np.testing.assert_allclose(samples.features[1, ROW, YAW], others[:, YAW].mean())
    # What it did show is kept, and so is everything else.
    np.testing.assert_allclose(samples.features[1, ROW, :4], whole.features[1, ROW, :4])
    np.testing.assert_allclose(np.delete(samples.features, ROW, 1), np.delete(whole.features, ROW, 1))


def test_a_walk_shows_as_much_as_it_lasted() -> None:
    model = MadeUpModel().worlds(1, 0)[0, 0]
    assert np.isfinite(features_of(shown_of(model, "no_progress"), 30.0)).all()
    assert np.isnan(features_of(shown_of(model, "diverged"), 30.0)).all()
    never = Observation(path_m=np.zeros((0, 2)), duration_s=0.0, yaw_change_rad=None, status="fell")
    assert np.isnan(features_of(never, 30.0)).all()
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
