"""The cache of walks, on made-up places: what is kept, what is refused, and what is simulated again."""

import gzip
import json
import math
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import pytest

from hexctl.backends.sim.world import World
from hexctl.control.batch import SimTrial
from hexctl.study import versions
from hexctl.study.walk_cache import CacheError, Place, WalkCache
from hexctl.study.walking import walk_all
from tests.robots import shipped
from tests.study.made_up import spec
from tests.study.watching import Remembering


@dataclass(frozen=True, slots=True)
class Case:
    """A case that is walked together with those of its group."""

    legs: tuple[int, ...]
    group: int = 0


@dataclass(frozen=True, slots=True)
class Stroll:
    """A walk as far as its case says."""

    case: Case
    distance_m: float

    @property
    def possible(self) -> bool:
        return not self.distance_m >= 100  # unknown is possible


@dataclass(frozen=True, kw_only=True)
class Park(Place[Case, Stroll]):
    """A place whose walks take no time."""

    WALK: ClassVar[type] = Stroll

    name: str = "park"
    broken: bool = False

    @property
    def title(self) -> str:
        return self.name

    @property
    def stem(self) -> str:
        return "park"

    def settings(self) -> dict[str, Any]:
        return {"name": self.name}

    def chunk_of(self, case: Case) -> Hashable:
        return case.group

    def keeps(self, walk: Stroll) -> bool:
        return walk.case.legs != (6,)

    def trial(self, case: Case) -> SimTrial:
        raise NotImplementedError

    def walk(self, cases: Sequence[Case], threads: int = 1) -> list[Stroll]:
        assert not self.broken
        return [Stroll(case, math.nan if len(case.legs) > 1 else 0.1 * case.legs[0]) for case in cases]


PARK = Park(robot=shipped(), world=World())
CASES = [Case((leg,), group=leg % 2) for leg in (1, 2, 3, 4)] + [Case((1, 2), group=2)]
WALKED = [(PARK, CASES), (replace(PARK, name="wood"), CASES[:2])]


def test_walks_are_simulated_once_and_come_back_as_they_were(tmp_path: Path) -> None:
    cache, first, again = WalkCache(tmp_path), Remembering(), Remembering()
    walks = walk_all(WALKED, cache, jobs=1, progress=first)
    assert [[walk.case for walk in some] for some in walks] == [cases for _, cases in WALKED]
    assert (first.walks, first.steps, first.notes) == (7, 7, ["park: 5 walks", "wood: 2 walks"])
    broken = [(replace(place, broken=True), cases) for place, cases in WALKED]
    assert repr(walk_all(broken, WalkCache(tmp_path), progress=again)) == repr(walks)
    assert (again.walks, again.notes) == (0, ["park: from the cache", "wood: from the cache"])
    assert cache.count(WALKED) == (7, 7)
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize("jobs", [1, 3])
def test_what_was_interrupted_goes_on_from_what_has_finished(jobs: int, tmp_path: Path) -> None:
    cache, rest = WalkCache(tmp_path), Remembering()
    with pytest.raises(KeyboardInterrupt):
        walk_all(WALKED, cache, jobs=jobs, progress=Remembering(interrupt_after=2))
    saved, total = cache.count(WALKED)
    assert 0 < saved < total == 7
    walks = walk_all(WALKED, cache, jobs=jobs, progress=rest)
    assert rest.steps == total - saved
    assert repr(walks) == repr(walk_all(WALKED, WalkCache(tmp_path / "new"), jobs=1))


def test_more_cases_join_those_in_the_file(tmp_path: Path) -> None:
    cache = WalkCache(tmp_path)
    walk_all([(PARK, CASES[:2])], cache)
    walk_all([(PARK, CASES[2:])], cache)
    assert cache.load(PARK).keys() == set(CASES)


def test_walks_that_a_place_does_not_keep_are_simulated_again(tmp_path: Path) -> None:
    walked = [(PARK, [Case((5,)), Case((6,))])]
    for steps in (2, 1):
        progress = Remembering()
        walk_all(walked, WalkCache(tmp_path), progress=progress)
        assert progress.steps == steps


@pytest.mark.parametrize(
    "content",
    [
        "",
        "[]x",
        "{}",
        "null",
        "[1]",
        '[{"case": {"legs": [1]}, "distance_m": 0.1}]',
        '["PARK"]',
        '["PARK", [{"case": {"legs": [1]}}]]',
        '["PARK", [{"case": {"legs": [1]}, "distance_m": "far"}]]',
        '["PARK", [{"case": {"legs": [1]}, "distance_m": 100.0}]]',
        pytest.param("[" * 100_000, id="deep"),
    ],
)
@pytest.mark.parametrize("pack", [gzip.compress, bytes])
def test_a_damaged_file_is_reported_and_its_walks_are_made_again(
    pack: Callable[[bytes], bytes], content: str, tmp_path: Path
) -> None:
    cache, progress = WalkCache(tmp_path), Remembering()
    cache.path_of(PARK).write_bytes(pack(content.replace("PARK", PARK.fingerprint).encode()))
    walk_all([(PARK, CASES)], cache, progress=progress)
    (note,) = cache.notes
    assert note.startswith(f"{cache.path_of(PARK)}: not usable")
    assert "\n" not in note
    assert (progress.notes[0], progress.steps) == (note, 5)
    assert WalkCache(tmp_path).count([(PARK, CASES)]) == (5, 5)


def test_the_file_of_another_place_is_reported_and_its_walks_are_made_again(tmp_path: Path) -> None:
    cache, progress = WalkCache(tmp_path), Remembering()
    walk_all(WALKED, cache)
    wood = WALKED[1][0]
    cache.path_of(wood).replace(cache.path_of(PARK))
    walk_all([(PARK, CASES)], cache, progress=progress)
    (note,) = cache.notes
    assert note.startswith(f"{cache.path_of(PARK)}: not usable")
    assert (progress.notes[0], progress.steps) == (note, 5)
    assert WalkCache(tmp_path).count([(PARK, CASES)]) == (5, 5)


#: Walks that no simulation gives, by what is wrong with them.
IMPOSSIBLE: dict[str, Callable[[dict[str, Any]], object]] = {
    "a status that does not exist": lambda walk: walk.update(status="flew"),
    "a missing number": lambda walk: walk.pop("distance_m"),
    "a number that is none": lambda walk: walk.update(signed_m=None),
    "a valid walk without an end": lambda walk: walk.update(status="ok", signed_m=math.nan),
}


@pytest.mark.parametrize("spoil", IMPOSSIBLE.values(), ids=list(IMPOSSIBLE))
def test_impossible_walks_are_reported_and_made_again(
    spoil: Callable[[dict[str, Any]], object], tmp_path: Path
) -> None:
    place, cache, progress = spec(5, "none", 0.1, (1, 2)), WalkCache(tmp_path), Remembering()
    (walks,) = walk_all([(place, place.codes)], cache, jobs=1)
    path = cache.path_of(place)
    fingerprint, stored = json.loads(gzip.decompress(path.read_bytes()))
    spoil(stored[1])
    path.write_bytes(gzip.compress(json.dumps([fingerprint, stored]).encode()))
    (again,) = walk_all([(place, place.codes)], cache, jobs=1, progress=progress)
    assert repr(again) == repr(walks)
    (note,) = cache.notes
    assert note.startswith(f"{path}: not usable")
    assert (progress.notes[0], progress.steps) == (note, 2)


def test_the_cases_of_equal_places_are_simulated_together_and_once(tmp_path: Path) -> None:
    walked = [(PARK, CASES[:3]), (WALKED[1][0], CASES[:1] * 2), (replace(PARK), CASES[2:])]
    cache, progress = WalkCache(tmp_path), Remembering()
    walks = walk_all(walked, cache, progress=progress)
    assert [[walk.case for walk in some] for some in walks] == [cases for _, cases in walked]
    assert (progress.steps, sorted(progress.notes)) == (6, ["park: 5 walks", "wood: 1 walks"])
    assert cache.count(walked) == (6, 6)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9, 0.999])
def test_a_truncated_file_is_not_used(share: float, tmp_path: Path) -> None:
    cache = WalkCache(tmp_path)
    walk_all(WALKED, cache)
    path = cache.path_of(PARK)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    assert cache.load(PARK) == {}
    assert "not usable" in cache.notes[0]


def test_a_flipped_bit_is_noticed(tmp_path: Path) -> None:
    cache = WalkCache(tmp_path)
    walk_all(WALKED, cache)
    path = cache.path_of(PARK)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    assert cache.load(PARK) == {}
    assert len(cache.notes) == 1


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    cache = WalkCache(tmp_path / "file")
    with pytest.raises(CacheError, match="cannot be written"):
        cache.save(PARK, [])
    with pytest.raises(CacheError, match="cannot be written"):
        cache.probe()


def test_other_code_has_other_files(monkeypatch: pytest.MonkeyPatch) -> None:
    before = spec().fingerprint
    monkeypatch.setattr(versions, "LANDSCAPE_VERSION", 99)
    for cached in (versions.code_versions, "hexctl.study.walk_cache._versions"):
        if isinstance(cached, str):
            monkeypatch.setattr(cached, lambda _module: versions.code_versions())
        else:
            cached.cache_clear()
    changed = spec().fingerprint
    monkeypatch.undo()
    versions.code_versions.cache_clear()
    assert changed != before == spec().fingerprint
