"""Walks of a benchmark: simulated in chunks, and kept on disk."""

import json
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from hexctl.files import atomic_write
from hexctl.study.landscapes.cache import CacheError, LandscapeCache
from hexctl.study.landscapes.evaluate import Progress, as_finished, finished_on_dask


class Conditions(Protocol):
    """Where walks are made: one robot in one world."""

    @property
    def number(self) -> int:
        """Number of the world."""

    @property
    def title(self) -> str:
        """Name for progress and messages."""

    @property
    def fingerprint(self) -> str:
        """Digest of all that decides a walk beside its case."""


CaseT = TypeVar("CaseT", bound=Hashable)
CaseT_co = TypeVar("CaseT_co", covariant=True)
PlaceT = TypeVar("PlaceT", bound=Conditions)


class WalkOf(Protocol[CaseT_co]):
    """The outcome of the walk of a case: a dataclass of plain values."""

    @property
    def case(self) -> CaseT_co:
        """What was walked."""


WalkT = TypeVar("WalkT", bound=WalkOf[Any])

#: What is to be walked: cases under each of some conditions.
Walked = Sequence[tuple[PlaceT, Sequence[CaseT]]]

#: Simulates some cases under one set of conditions, with a number of threads.
Simulate = Callable[[PlaceT, Sequence[CaseT], int], list[WalkT]]


class WalkCache(Generic[PlaceT, CaseT, WalkT]):
    """Walks on disk, a file for each robot and world, beside the landscapes of a study.

    Args:
        landscapes: their cache, which takes the notes on files that are not usable.
        name: first word of the files' names.
        read: walk of its values in a file; raises ValueError for what no simulation gives.
        keeps: whether a walk is to be kept.
    """

    def __init__(
        self,
        landscapes: LandscapeCache,
        *,
        name: str,
        read: Callable[[dict[str, Any]], WalkT],
        keeps: Callable[[WalkT], bool] = lambda _: True,
    ) -> None:
        self._landscapes, self._name, self._read, self._keeps = landscapes, name, read, keeps

    def path_of(self, conditions: PlaceT) -> Path:
        """File of the walks under some conditions."""
        return self._landscapes.folder / f"{self._name}-{conditions.number}-{conditions.fingerprint}.json"

    def load(self, conditions: PlaceT) -> dict[CaseT, WalkT]:
        """Walks as saved; empty where there is no usable file."""
        path = self.path_of(conditions)
        if not path.exists():
            return {}
        try:
            walks = [self._read(values) for values in json.loads(path.read_text(encoding="utf-8"))]
        except (OSError, ValueError, TypeError, AttributeError, KeyError) as error:
            reason = " ".join(str(error).split())
            self._landscapes.notes.append(f"{path}: not usable ({reason}); it is computed again")
            return {}
        return {walk.case: walk for walk in walks}

    def save(self, conditions: PlaceT, walks: Iterable[WalkT]) -> None:
        """Replace the file of some conditions; raises CacheError when the disk refuses."""
        path = self.path_of(conditions)
        kept: list[dict[str, Any]] = [asdict(walk) for walk in walks if self._keeps(walk)]  # type: ignore[call-overload]
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            atomic_write(path, json.dumps(kept))
        except OSError as error:
            raise CacheError(f"study cache: {path} cannot be written: {error}") from error

    def count(self, walked: Walked[PlaceT, CaseT]) -> tuple[int, int]:
        """Number of walks saved, and of all walks, of what is to be walked."""
        saved = 0
        for conditions, cases in walked:
            known = self.load(conditions)
            saved += sum(case in known for case in cases)
        return saved, sum(len(cases) for _, cases in walked)


@dataclass(frozen=True, kw_only=True)
class _Chunk(Generic[PlaceT, CaseT, WalkT]):
    """Cases that are simulated together under one set of conditions."""

    conditions: PlaceT
    cases: tuple[CaseT, ...]
    simulate: Simulate[PlaceT, CaseT, WalkT]

    def walk(self, threads: int) -> tuple["_Chunk[PlaceT, CaseT, WalkT]", list[WalkT]]:
        """The chunk and its walks."""
        return self, self.simulate(self.conditions, self.cases, threads)


def walk_all(
    walked: Walked[PlaceT, CaseT],
    cache: WalkCache[PlaceT, CaseT, WalkT],
    simulate: Simulate[PlaceT, CaseT, WalkT],
    alike: Callable[[CaseT], Hashable],
    progress: Progress,
    jobs: int | None = None,
    *,
    dask: str | None = None,
) -> list[tuple[PlaceT, WalkT]]:
    """All walks of some cases, simulated where the cache lacks them.

    When this is interrupted, the chunks that have finished are in the cache, and another call continues from
    there.

    Args:
        walked: conditions and their cases.
        cache: of the walks.
        simulate: walks a chunk.
        alike: cases of which this is equal are one chunk under the same conditions.
        progress: observer.
        jobs: threads that simulate; None is all cores here, one for each chunk on a Dask worker.
        dask: address of a Dask scheduler whose workers simulate, for which conditions, cases and `simulate`
            are pickled; None simulates here.

    Raises CacheError when walks cannot be saved, InputError for an address that does not answer.
    """
    known = {one.fingerprint: cache.load(one) for one, _ in walked}
    todo = [
        _Chunk(conditions=one, cases=chunk, simulate=simulate)
        for one, cases in walked
        for chunk in _chunks([case for case in cases if case not in known[one.fingerprint]], alike)
    ]
    wanted = {one.fingerprint: cases for one, cases in walked}
    left, total = sum(len(chunk.cases) for chunk in todo), sum(len(cases) for _, cases in walked)
    if left < total:
        progress.note(f"{total - left} of {total} walks: from the cache")
    progress.stage("walks (Ctrl-C stops, the same command continues)", left)
    chunks = [chunk.walk for chunk in todo]
    for chunk, walks in as_finished(chunks, jobs) if dask is None else finished_on_dask(chunks, dask, jobs):
        place = chunk.conditions
        saved = known[place.fingerprint]
        saved.update((walk.case, walk) for walk in walks)
        cache.save(place, saved.values())
        for _ in walks:
            progress.step()
        if all(case in saved for case in wanted[place.fingerprint]):
            progress.note(f"{place.title}: {len(wanted[place.fingerprint])} walks")
    return [(one, known[one.fingerprint][case]) for one, cases in walked for case in cases]


def _chunks(cases: Sequence[CaseT], alike: Callable[[CaseT], Hashable]) -> Iterator[tuple[CaseT, ...]]:
    groups: dict[Hashable, list[CaseT]] = {}
    for case in cases:
        groups.setdefault(alike(case), []).append(case)
    yield from map(tuple, groups.values())
