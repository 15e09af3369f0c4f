"""Files of repertoires: saved, refused, found."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hexctl.archive import ArchiveFileError
from hexctl.control.body_symmetry import IDENTITY
from hexctl.control.monitor.repertoire_store import (
    describe_repertoire,
    find_repertoire,
    list_repertoires,
    load_repertoire,
    named_repertoire,
    repertoire_files,
    save_repertoire,
)
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import InputError
from hexctl.gait.gait import make_gait
from hexctl.robot.configs import config_root
from tests.control.monitor.repertoires import MIRROR, ON_IS_BEST, made_up, with_fall
from tests.robots import shipped

PLAN = TrialPlan(gait=make_gait(shipped(), "tripod"), hold="line")


def test_what_is_saved_is_loaded(tmp_path: Path) -> None:
    repertoire = made_up(with_fall(ON_IS_BEST, 2), symmetries=(IDENTITY, MIRROR))
    path = tmp_path / "deep" / "ant.npz"
    save_repertoire(repertoire, path)
    loaded = load_repertoire(path)
    assert loaded.digest() == repertoire.digest()
    assert loaded.head == repertoire.head
    assert loaded.symmetries == repertoire.symmetries
    (one,), (before,) = loaded.situations, repertoire.situations
    assert one.candidates == before.candidates
    assert one.failed == before.failed
    np.testing.assert_array_equal(one.speeds, before.speeds)
    np.testing.assert_array_equal(one.costs, before.costs)
    assert (one.walks, one.valid.tolist()) == (4, [1.0, 1.0, 0.75])


def test_what_is_no_whole_repertoire_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.npz"
    with pytest.raises(InputError, match="no file at"):
        load_repertoire(path)
    save_repertoire(made_up(), path)
    content = path.read_bytes()
    for bad in (b"", b"my diary", content[:-60]):
        path.write_bytes(bad)
        with pytest.raises(InputError, match="not a repertoire, or cut off"):
            load_repertoire(path)
    np.savez(path, head=np.array(json.dumps({"format": "hexctl prior"})))
    with pytest.raises(InputError, match="it is not a repertoire; allowed: a repertoire as hexctl prior"):
        load_repertoire(path)


@pytest.mark.parametrize(
    ("change", "said"),
    [({"version": 9}, "it has version 9, this hexctl reads 1"), ({"pace_hz": 2.0}, "it was altered")],
)
def test_a_head_that_was_changed_is_refused(change: dict[str, float], said: str, tmp_path: Path) -> None:
    path = tmp_path / "x.npz"
    save_repertoire(made_up(), path)
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    arrays["head"] = np.array(json.dumps(json.loads(str(arrays["head"])) | change))
    np.savez(path, **arrays)
    with pytest.raises(InputError, match=said):
        load_repertoire(path)


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "a-file").touch()
    with pytest.raises(ArchiveFileError, match="cannot be written"):
        save_repertoire(made_up(), tmp_path / "a-file" / "x.npz")


def test_one_that_was_built_is_found_before_the_shipped_one(tmp_path: Path) -> None:
    path = tmp_path / "repertoires" / "mine.npz"
    save_repertoire(made_up(), path)
    (path.parent / "damaged.npz").write_bytes(b"my diary")
    found = find_repertoire(shipped(), PLAN, tmp_path)
    assert found is not None
    assert found.origin == {"by": "hand"}
    save_repertoire(replace(made_up(), pace_hz=0.2), path)
    other = find_repertoire(shipped(), PLAN, tmp_path)
    assert other is None or other.origin != {"by": "hand"}


@pytest.mark.parametrize("path", sorted((config_root() / "repertoires").glob("*.npz")), ids=lambda p: p.stem)
def test_shipped_repertoires_are_small_and_of_the_robots_that_are_shipped(path: Path) -> None:
    robot = shipped(path.stem)
    repertoire = load_repertoire(path)
    assert path.stat().st_size < 200_000
    assert repertoire.covers(robot, TrialPlan(gait=make_gait(robot, "tripod"), hold="line"))
    assert path in repertoire_files()
    described = describe_repertoire(path)
    assert described["walks"] >= 4
    assert {"locked", "limp", "missing", "stuck:coxa", "limp:tibia"} <= set(described["legs"])
    assert 0 < described["others"] < described["situations"]


def test_all_are_described_and_a_damaged_one_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "repertoires" / "mine.npz"
    save_repertoire(made_up(), path)
    (path.parent / "damaged.npz").write_bytes(b"my diary")
    damaged: list[InputError] = []
    described = list_repertoires(tmp_path, on_damaged=damaged.append)
    assert described[0] == {"repertoire": str(path), **describe_repertoire(path)}
    assert ["damaged.npz" in str(error) for error in damaged] == [True]
    assert named_repertoire("mine", tmp_path) == path
    assert named_repertoire("nowhere.npz", tmp_path) == Path("nowhere.npz")
