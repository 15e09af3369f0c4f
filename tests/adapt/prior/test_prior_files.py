"""Finding the prior of a session, and the priors that are shipped."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.adapt.prior.prior import PriorKey, ScorePrior, load_prior, open_prior, save_prior
from hexctl.adapt.prior.prior_files import (
    check_prior,
    describe_prior,
    find_prior,
    prior_files,
    shipped_priors,
)
from hexctl.adapt.prior.samples import covering, samples_of, score_samples_of
from hexctl.errors import InputError
from hexctl.robot.failure import Failure
from tests.adapt.priors import key_of, made_up_prior, made_up_score_prior, plan_of
from tests.robots import ROBOT_NAMES, shipped

SHIPPED = sorted(shipped_priors().glob("*.npz"))
MAX_BYTES = 1_500_000


def save(folder: Path, name: str, question: PriorKey) -> Path:
    path = folder / name
    save_prior(made_up_prior(question, worlds=1), path)
    return path


def test_the_prior_that_fits_is_found_whatever_its_name(tmp_path: Path) -> None:
    save(tmp_path, "a.npz", key_of(duration_s=5.0))
    fits = save(tmp_path, "b.npz", key_of())
    save(tmp_path, "c.npz", key_of(self_rotation="front"))
    found = find_prior(key_of(), [tmp_path])
    assert (found.path, found.reason) == (fits, "")


def test_the_first_folder_wins_and_one_that_is_missing_is_none(tmp_path: Path) -> None:
    first = save(tmp_path / "mine", "z.npz", key_of())
    second = save(tmp_path / "shipped", "a.npz", key_of())
    nowhere = tmp_path / "nowhere"
    assert find_prior(key_of(), [nowhere, tmp_path / "mine", tmp_path / "shipped"]).path == first
    assert find_prior(key_of(), [tmp_path / "shipped", tmp_path / "mine"]).path == second
    assert prior_files([nowhere, tmp_path / "mine", tmp_path / "shipped"]) == [first, second]


def test_files_that_are_no_priors_are_passed_over(tmp_path: Path) -> None:
    (tmp_path / "a.npz").write_text("my diary")
    (tmp_path / "b.npz").touch()
    np.savez(tmp_path / "c.npz", a=np.arange(3))
    (tmp_path / "d.npz").mkdir()
    cut = save(tmp_path, "e.npz", key_of())
    cut.write_bytes(cut.read_bytes()[:-200])
    (tmp_path / "f.npz").symlink_to(tmp_path / "gone")
    fits = save(tmp_path, "g.npz", key_of())
    assert find_prior(key_of(), [tmp_path]).path == fits
    fits.unlink()
    assert find_prior(key_of(), [tmp_path]).path is None


def test_files_of_another_name_are_not_looked_at(tmp_path: Path) -> None:
    save(tmp_path, "a.npz", key_of()).rename(tmp_path / "a.npz.bak")
    assert find_prior(key_of(), [tmp_path]).reason == "none has been built"


def test_without_priors_the_reason_is_that_there_are_none(tmp_path: Path) -> None:
    found = find_prior(key_of(), [tmp_path, tmp_path / "nowhere"])
    assert (found.path, found.reason) == (None, "none has been built")


def test_the_reason_names_the_nearest(tmp_path: Path) -> None:
    save(tmp_path, "a.npz", key_of(shipped("phantomx"), duration_s=12.0))
    save(tmp_path, "b.npz", key_of(duration_s=12.0))
    save(tmp_path, "c.npz", key_of(duration_s=12.0, self_rotation="none"))
    found = find_prior(key_of(), [tmp_path])
    assert found.path is None
    assert found.reason == "b.npz is for duration 12 s, not 30 s"


def test_a_prior_of_other_legs_is_passed_over_and_named(tmp_path: Path) -> None:
    robot = shipped("pexod")
    question = key_of(robot, failure=Failure(leg=2))
    save_prior(made_up_prior(question, legs=(1, 6), worlds=1), tmp_path / "a.npz")
    covers = covering(robot, plan_of(robot, failure=Failure(leg=2)))
    found = find_prior(question, [tmp_path], covers=covers)
    assert (found.path, found.reason) == (None, "a.npz is for failed leg 1, 6")
    with pytest.raises(InputError, match="is for failed leg 1, 6; allowed: a prior for the same trials"):
        check_prior(tmp_path / "a.npz", question, covers=covers)
    save_prior(made_up_prior(question, legs=(5,), worlds=1), tmp_path / "b.npz")
    assert find_prior(question, [tmp_path], covers=covers).path == tmp_path / "b.npz"


def test_a_prior_that_was_given_is_checked_in_one_line(tmp_path: Path) -> None:
    path = save(tmp_path, "mine.npz", key_of(duration_s=12.0, self_rotation="front"))
    check_prior(path, key_of(duration_s=12.0, self_rotation="front"))
    with pytest.raises(InputError) as refused:
        check_prior(path, key_of())
    assert str(refused.value) == (
        f"prior {path}: is for self-rotation front, not rear, duration 12 s, not 30 s; "
        "allowed: a prior for the same trials"
    )


def test_a_prior_of_a_question_with_other_parts_is_damaged(tmp_path: Path) -> None:
    path = tmp_path / "odd.npz"
    prior = made_up_prior(worlds=1)
    odd = prior.key.as_json() | {"weather": "rain"}

    class Odd(PriorKey):
        def as_json(self) -> dict[str, object]:
            return odd

    save_prior(replace(prior, key=Odd(**prior.key.as_json())), path)
    with pytest.raises(InputError, match="it is damaged"):
        check_prior(path, key_of())
    assert find_prior(key_of(), [tmp_path]).path is None


def test_there_is_a_shipped_prior_for_the_default_session() -> None:
    found = find_prior(key_of(), [shipped_priors()])
    assert found.path is not None
    assert found.path.name == "ant-locked-rear-30s.npz"


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.name)
def test_a_shipped_prior_is_whole_small_and_for_the_shipped_robot(path: Path) -> None:
    prior = open_prior(path)
    assert prior.key.robot in ROBOT_NAMES
    robot = shipped(prior.key.robot)
    assert path.name.startswith(f"{robot.name}-")
    asked = key_of(robot, duration_s=prior.key.duration_s)
    usual: dict[str, Any] = {"failure": "locked", "self_rotation": "rear", "hold": "none"}
    assert replace(prior.key, posture="stance", **usual).differences(asked) == []
    assert path.stat().st_size < MAX_BYTES
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


def test_a_key_without_a_hold_is_that_of_open_loop_walks(tmp_path: Path) -> None:
    path, steered = save(tmp_path, "a.npz", key_of()), replace(key_of(), hold="line")
    assert load_prior(path).key.hold == "none"
    with pytest.raises(InputError, match="is for hold none, not line"):
        check_prior(path, steered)
    other = save(tmp_path, "b.npz", steered)
    assert load_prior(other).key == steered
    assert find_prior(steered, [tmp_path]).path == other


def test_what_a_score_prior_is_for_is_told(tmp_path: Path) -> None:
    save_prior(made_up_score_prior(), tmp_path / "scores.npz")
    described = describe_prior(tmp_path / "scores.npz")
    assert (described["hold"], described["posture"], described["worlds"]) == ("line", "auto", 3)
    assert described["scores"] == ["speed", "cost", "tilt", "steadiness"]


def test_a_prior_for_another_hold_posture_or_failure_is_refused_by_name(tmp_path: Path) -> None:
    path, prior = tmp_path / "scores.npz", made_up_score_prior()
    save_prior(prior, path)
    check_prior(path, prior.key)
    other = replace(prior.key, hold="heading", posture="stance", failure="limp")
    with pytest.raises(InputError, match="failure locked, not limp, hold line, not heading, posture auto, n"):
        check_prior(path, other)
    assert find_prior(other, [tmp_path]).path is None
