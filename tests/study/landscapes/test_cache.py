from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from hexctl.errors import RobotFaultError
from hexctl.study.landscapes import versions
from hexctl.study.landscapes.cache import CacheError, LandscapeCache
from hexctl.study.landscapes.evaluate import Chunk, ChunkDone, fill, simulate_chunk, simulate_here
from tests.study.made_up import made_up, same, spec, spread_out
from tests.study.watching import Counting, Remembering

CODES = (1, 2, 3, 4, 5)


def test_a_landscape_is_simulated_once(tmp_path: Path) -> None:
    specs = [spec(5, "none", 0.2, CODES), spec(5, "rear", 0.2, CODES)]
    cache, first, again = LandscapeCache(tmp_path), Counting(), Counting()
    walked = fill(specs, cache, first, Remembering(), chunk_size=2)
    watcher = Remembering()
    known = fill(specs, cache, again, watcher, chunk_size=2)
    assert (len(first.chunks), len(again.chunks)) == (6, 0)
    assert watcher.known == [True, True]
    assert all(same(one, other) for one, other in zip(walked, known, strict=True))
    assert [landscape.spec for landscape in known] == specs


def test_interrupted_work_goes_on_from_what_is_done(tmp_path: Path) -> None:
    asked = [spec(3, "none", 0.2, CODES)]
    with pytest.raises(KeyboardInterrupt):
        fill(asked, LandscapeCache(tmp_path), Counting(interrupt_after=2), Remembering(), chunk_size=2)
    rest = Counting()
    (landscape,) = fill(asked, LandscapeCache(tmp_path), rest, Remembering(), chunk_size=2)
    assert [chunk.codes for chunk in rest.chunks] == [(5,)]
    (whole,) = fill(asked, LandscapeCache(tmp_path / "new"), simulate_here(1), Remembering())
    assert same(landscape, whole)


def test_a_saved_landscape_is_read_back_as_it_was(tmp_path: Path) -> None:
    landscape, cache = made_up(6, "rear", spread_out(2.0), invalid=[7]), LandscapeCache(tmp_path)
    cache.save(landscape)
    assert same(cache.load(landscape.spec), landscape)
    assert [path.suffix for path in tmp_path.iterdir()] == [".npz"]
    assert cache.notes == []


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9, 0.999])
def test_a_truncated_file_is_not_used(tmp_path: Path, share: float) -> None:
    landscape, cache = made_up(6, "rear", spread_out(2.0)), LandscapeCache(tmp_path)
    cache.save(landscape)
    path = cache.path_of(landscape.spec)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    assert len(cache.load(landscape.spec).missing) == 120
    assert "not usable" in cache.notes[0]


def test_a_flipped_bit_is_noticed(tmp_path: Path) -> None:
    landscape, cache = made_up(6, "rear", spread_out(2.0)), LandscapeCache(tmp_path)
    cache.save(landscape)
    path = cache.path_of(landscape.spec)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    assert not cache.load(landscape.spec).complete
    assert len(cache.notes) == 1


def test_the_file_of_another_landscape_is_not_used(tmp_path: Path) -> None:
    landscape, cache = made_up(6, "rear", spread_out(2.0)), LandscapeCache(tmp_path)
    cache.save(landscape)
    other = made_up(6, "none", spread_out(1.0)).spec
    cache.path_of(landscape.spec).rename(cache.path_of(other))
    assert not cache.load(other).done.any()
    assert "another landscape" in cache.notes[0]


def test_a_file_that_is_something_else_is_computed_anew_with_a_note(tmp_path: Path) -> None:
    asked, cache = spec(1, "none", 0.2, CODES), LandscapeCache(tmp_path)
    cache.path_of(asked).write_text("hello")
    (landscape,) = fill([asked], cache, simulate_here(), Remembering())
    assert landscape.complete
    assert len(cache.notes) == 1
    assert same(LandscapeCache(tmp_path).load(asked), landscape)


def test_valid_gaits_without_numbers_are_not_believed(tmp_path: Path) -> None:
    landscape, cache = made_up(6, "rear", np.full(120, np.nan)), LandscapeCache(tmp_path)
    cache.save(landscape)
    assert not cache.load(landscape.spec).done.any()


def test_other_code_has_other_files(monkeypatch: pytest.MonkeyPatch) -> None:
    before = spec().fingerprint
    monkeypatch.setattr(versions, "LANDSCAPE_VERSION", 99)
    versions.code_versions.cache_clear()
    changed = spec().fingerprint
    monkeypatch.undo()
    versions.code_versions.cache_clear()
    assert changed != before == spec().fingerprint


def test_a_worker_with_other_code_is_refused(tmp_path: Path) -> None:
    asked = spec(1, "none", 0.1, (1,))

    def foreign(chunks: Sequence[Chunk]) -> list[ChunkDone]:
        done = simulate_chunk(chunks[0])
        return [ChunkDone(chunk=done.chunk, rows=done.rows, versions={**done.versions, "mujoco": "1.0"})]

    with pytest.raises(RobotFaultError, match=r"mujoco 1\.0"):
        fill([asked], LandscapeCache(tmp_path), foreign, Remembering())
    assert not LandscapeCache(tmp_path).load(asked).done.any()


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(CacheError, match="cannot be written"):
        LandscapeCache(tmp_path / "file").save(made_up(6, "rear", spread_out(2.0)))
