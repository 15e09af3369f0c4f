"""A prior's file and key: what goes in comes out, and damage is refused in one line."""

import json
import math
import os
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.adapt.prior.prior import (
    CHECKPOINTS,
    KIND,
    Prior,
    ScorePrior,
    check_place,
    load_prior,
    load_score_prior,
    open_prior,
    save_prior,
)
from hexctl.archive import ArchiveFileError
from hexctl.errors import HexctlError, InputError
from hexctl.robot.failure import Failure
from hexctl.robot.failure_grammar import parse_kind
from hexctl.robot.loader import load_robot
from tests.adapt.priors import key_of, made_up_prior, made_up_score_prior
from tests.robots import edited_file, put, shipped

ARRAYS = ("signed_m", "progress_m", "yaw_rad", "sag_rad")

#: What a prior may have or lack.
STANDING = "sag_rad"


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


def test_the_digest_survives_the_file_and_a_second_one(path: Path, tmp_path: Path) -> None:
    loaded = load_prior(path)
    assert loaded.digest() == prior_with_a_fall().digest()
    save_prior(loaded, tmp_path / "again.npz")
    assert same(load_prior(tmp_path / "again.npz"), loaded)


@pytest.mark.parametrize(
    "change",
    [
        lambda prior: replace(prior, key=key_of(duration_s=12.0)),
        lambda prior: replace(prior, legs=(2, 4)),
        lambda prior: replace(prior, origin={**prior.origin, "worlds": 3}),
        *[lambda prior, name=name: replace(prior, **{name: getattr(prior, name) + 0.01}) for name in ARRAYS],
    ],
    ids=["question", "legs", "origin", *ARRAYS],
)
def test_the_digest_changes_with_anything(change: Any) -> None:
    prior = prior_with_a_fall()
    assert change(prior).digest() != prior.digest()


def test_a_prior_that_knows_no_stances_is_one_too(tmp_path: Path) -> None:
    prior = replace(prior_with_a_fall(), sag_rad=None)
    save_prior(prior, tmp_path / "some.npz")
    loaded = load_prior(tmp_path / "some.npz")
    assert loaded.sag_rad is None
    assert loaded.digest() == prior.digest() != prior_with_a_fall().digest()


def test_the_head_says_what_it_is_for(path: Path) -> None:
    head = KIND.read_head(path)
    assert head["question"] == key_of().as_json()
    assert head["legs"] == [2, 5]


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    assert "no file at" in refusal(tmp_path / "nowhere.npz")


@pytest.mark.parametrize("content", [b"", b"my diary\n" * 100, b"\x93NUMPY", b"PK\x03\x04" + bytes(99)])
def test_another_file_is_no_prior(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "diary.npz"
    path.write_bytes(content)
    assert "it is not a prior" in refusal(path)


def test_a_folder_is_no_prior(tmp_path: Path) -> None:
    assert "it is not a prior" in refusal(tmp_path)


def test_arrays_of_another_program_are_no_prior(tmp_path: Path) -> None:
    path, alone = tmp_path / "other.npz", tmp_path / "alone.npy"
    np.savez(path, a=np.arange(3))
    np.save(alone, np.arange(3))
    for file in (path, alone):
        assert "it is not a prior" in refusal(file)


@pytest.mark.parametrize("share", [0.001, 0.01, 0.1, 0.25, 0.5, 0.75, 0.9, 0.99, 0.999])
def test_a_file_that_is_cut_off_is_refused(share: float, path: Path) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    assert "cut off" in refusal(path)


def test_a_file_whose_last_bytes_are_missing_is_refused(path: Path) -> None:
    content = path.read_bytes()
    for missing in range(1, 40):
        path.write_bytes(content[:-missing])
        refusal(path)


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
        ({"version": None}, "it has version None"),
        ({"format": "hexctl landscape"}, "it is not a prior"),
        ({"digest": "0" * 32}, "altered"),
        ({"legs": [2, 3]}, "altered"),
        ({"legs": [2]}, "damaged"),
        ({"legs": 5}, "damaged"),
        ({"question": {}}, "damaged"),
        ({"question": None}, "damaged"),
        ({"origin": {}}, "altered"),
    ],
    ids=str,
)
def test_a_head_that_is_another_is_refused(change: dict[str, Any], words: str, path: Path) -> None:
    head, arrays = parts_of(path)
    write(path, {**head, **change}, **arrays)
    assert words in refusal(path)


@pytest.mark.parametrize("key", ["format", "version", "digest", "question", "legs", "origin"])
def test_a_head_without_a_part_is_refused(key: str, path: Path) -> None:
    head, arrays = parts_of(path)
    del head[key]
    write(path, head, **arrays)
    refusal(path)


@pytest.mark.parametrize("head", ["", "[]", "7", "not json"])
def test_a_head_that_is_none_is_refused(head: str, path: Path) -> None:
    write(path, head, **parts_of(path)[1])
    assert "it is not a prior" in refusal(path)


@pytest.mark.parametrize("name", ARRAYS)
def test_numbers_that_were_altered_are_refused(name: str, path: Path) -> None:
    head, arrays = parts_of(path)
    arrays[name][0, 0, 3] += np.float16(0.5)
    write(path, head, **arrays)
    assert "altered" in refusal(path)


@pytest.mark.parametrize("name", ARRAYS)
def test_numbers_that_do_not_fit_are_refused(name: str, path: Path) -> None:
    head, arrays = parts_of(path)
    for other in (arrays[name][:, :1], arrays[name][..., :9], np.float16(1.0), np.zeros(3)):
        write(path, head, **{**arrays, name: other})
        assert "damaged" in refusal(path)
    del arrays[name]
    write(path, head, **arrays)
    assert ("altered" if name == STANDING else "damaged") in refusal(path)


def test_a_prior_of_no_world_or_no_leg_cannot_be_made() -> None:
    prior = made_up_prior()
    nothing: dict[str, Any] = {
        "signed_m": np.zeros((1, 0, 120, CHECKPOINTS)),
        "progress_m": np.zeros((1, 0, 120, CHECKPOINTS)),
        "yaw_rad": np.zeros((1, 0, 120)),
    }
    with pytest.raises(ValueError, match="has shape"):
        replace(prior, **nothing)
    with pytest.raises(ValueError, match="has shape"):
        replace(prior, legs=())


@pytest.mark.slow
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


def test_saving_leaves_nothing_but_the_prior(path: Path) -> None:
    save_prior(small_prior(), path)
    assert list(path.parent.iterdir()) == [path]
    assert load_prior(path).worlds == 1


def test_saving_makes_the_folder(tmp_path: Path) -> None:
    path = tmp_path / "runs" / "priors" / "new.npz"
    save_prior(small_prior(), path)
    assert load_prior(path).digest() == small_prior().digest()


def test_a_disk_that_refuses_keeps_the_old_prior(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = path.read_bytes()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(ArchiveFileError, match=r"some\.npz cannot be written: No space left on device"):
        save_prior(small_prior(), path)
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


def test_a_disk_that_fails_half_way_leaves_no_part_of_a_prior(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = path.read_bytes()

    def breaks(*_: object) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(Path, "replace", breaks)
    with pytest.raises(ArchiveFileError, match="cannot be written"):
        save_prior(small_prior(), path)
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("write_there", [check_place, lambda path: save_prior(small_prior(), path)])
def test_a_place_that_is_none_is_refused_in_one_line(write_there: Any, tmp_path: Path) -> None:
    (tmp_path / "a-file").touch()
    with pytest.raises(ArchiveFileError) as refused:
        write_there(tmp_path / "a-file" / "new.npz")
    assert isinstance(refused.value, HexctlError)
    assert "cannot be written" in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_may_not_be_written_is_refused(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(ArchiveFileError, match="Permission denied"):
        save_prior(small_prior(), tmp_path / "new.npz")


def test_looking_at_a_place_leaves_nothing_there(path: Path) -> None:
    before = path.read_bytes()
    check_place(path)
    check_place(path.with_name("new.npz"))
    assert list(path.parent.iterdir()) == [path]
    assert path.read_bytes() == before


def test_the_same_question_differs_in_nothing() -> None:
    assert key_of().differences(key_of()) == []


@pytest.mark.parametrize("options", [{"failure": Failure(leg=2)}, {"heading_rad": 1.0}])
def test_neither_leg_nor_heading_makes_another_question(options: dict[str, Any]) -> None:
    # The failed leg points to the rear of wherever the robot goes.
    assert key_of().differences(key_of(**options)) == []


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"duration_s": 12.5}, "duration 30 s, not 12.5 s"),
        ({"self_rotation": "front"}, "self-rotation rear, not front"),
        ({"failure": Failure(leg=5, kind="limp")}, "failure locked, not limp"),
        ({"failure": parse_kind(5, "weak:0.5")}, "failure locked, not weak:0.5"),
    ],
)
def test_another_trial_is_named_with_both_values(options: dict[str, Any], words: str) -> None:
    assert key_of().differences(key_of(**options)) == [words]


def test_without_self_rotation_the_heading_makes_another_question() -> None:
    """The body does not turn to where it goes: it walks forward, or to its side."""
    forward, left = (
        key_of(self_rotation="none", heading_rad=heading_rad) for heading_rad in (0.0, math.pi / 2)
    )
    assert forward.differences(left) == ["heading 0 deg, not 90 deg"]


def test_a_failure_in_another_degree_is_another_question() -> None:
    weak, weaker = (key_of(failure=parse_kind(5, f"weak:{share}")) for share in (0.5, 0.25))
    assert weak.differences(weaker) == ["failure weak:0.5, not weak:0.25"]


def test_another_gait_is_another_question() -> None:
    question = key_of()
    assert question.differences(replace(question, pace_hz=0.75)) == ["pace 0.9 Hz, not 0.75 Hz"]
    assert question.differences(replace(question, amplitude=0.05)) == ["amplitude 0.11, not 0.05"]
    assert question.differences(replace(question, height=0.03)) == ["height 0.02, not 0.03"]


def test_another_robot_is_named_once() -> None:
    differences = key_of().differences(key_of(shipped("phantomx")))
    assert "robot ant, not phantomx" in differences
    assert not any("description" in words or "fingerprint" in words for words in differences)


def test_the_same_robot_with_another_description_is_another_question(tmp_path: Path) -> None:
    heavier = load_robot(str(edited_file(tmp_path, put("body", "mass_kg", 3.0))))
    assert key_of().differences(key_of(heavier)) == ["another description of ant"]


def test_all_differences_are_named() -> None:
    other = key_of(duration_s=5.0, self_rotation="none", failure=Failure(leg=1, kind="missing"))
    assert key_of().differences(other) == [
        "failure locked, not missing",
        "self-rotation rear, not none",
        "duration 30 s, not 5 s",
    ]


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


def test_a_score_prior_of_another_shape_is_refused() -> None:
    prior = made_up_score_prior()
    with pytest.raises(ValueError, match="valid has shape"):
        replace(prior, valid=prior.valid[:, :1])
    with pytest.raises(ValueError, match="log_scores has shape"):
        replace(prior, log_scores=prior.log_scores[..., :3])
