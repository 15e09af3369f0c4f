"""Walks of experiments, the places where they are made, and their cache on disk."""

import gzip
import hashlib
import json
import math
import zlib
from abc import ABC, abstractmethod
from collections.abc import Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from pydantic import ConfigDict, TypeAdapter

from hexctl.archive import damage_reason
from hexctl.backends.sim.world import World
from hexctl.control.batch import SimTrial, run_sim_trials
from hexctl.errors import HexctlError
from hexctl.files import atomic_write, write_trouble
from hexctl.robot.model import Robot
from hexctl.study.versions import code_versions

#: Folder of the commands' cache, below the working directory.
FOLDER = Path("runs/study-cache")

#: Walks simulated together. They end together, after four seconds of work for 30 s of walking: only then are
#: they counted and saved. Larger groups are at most 7 % quicker.
CHUNK_SIZE = 10

#: Statuses of walks that end on their feet.
ENDED = ("ok", "no_progress")


def known(value: float | None) -> float:
    """Return a number of a walk; NaN if it is unknown."""
    return math.nan if value is None else float(value)


class CacheError(HexctlError, OSError):
    """The cache folder cannot be written."""


CaseT = TypeVar("CaseT", bound=Hashable)
#: Outcome of a walk: a dataclass of plain values, with its `case`.
WalkT = TypeVar("WalkT")


@dataclass(frozen=True, kw_only=True)
class Place(ABC, Generic[CaseT, WalkT]):
    """A robot in a world. The place and a case decide a walk.

    Attributes:
        world: simulated world, its sensors included.
    """

    robot: Robot
    world: World

    #: Class of the walks, which its `of` makes of a case, the trial and the result.
    WALK: ClassVar[Any]

    @property
    @abstractmethod
    def title(self) -> str:
        """Name for progress and messages."""

    @property
    @abstractmethod
    def stem(self) -> str:
        """First part of the cache file's name."""

    @abstractmethod
    def settings(self) -> dict[str, Any]:
        """Return plain JSON values that decide a walk apart from robot, world, code and case."""

    @abstractmethod
    def trial(self, case: CaseT) -> SimTrial:
        """Return the trial of a case."""

    def walk(self, cases: Sequence[CaseT], threads: int = 1) -> list[WalkT]:
        """Simulate some cases together."""
        trials = [self.trial(case) for case in cases]
        results = run_sim_trials(trials, threads)
        return [self.WALK.of(*one) for one in zip(cases, trials, results, strict=True)]

    def chunks(self, cases: Sequence[CaseT]) -> Iterator[tuple[CaseT, ...]]:
        """Divide cases into groups simulated together, of up to `CHUNK_SIZE`."""
        groups: dict[Hashable, list[CaseT]] = {}
        for case in cases:
            groups.setdefault(self.chunk_of(case), []).append(case)
        for group in groups.values():
            for first in range(0, len(group), CHUNK_SIZE):
                yield tuple(group[first : first + CHUNK_SIZE])

    def chunk_of(self, case: CaseT) -> Hashable:
        """Return a value; only cases with equal ones are simulated together."""
        return None

    def keeps(self, walk: WalkT) -> bool:
        """Whether a walk is saved in the cache."""
        return True

    def outcome(self, walks: Sequence[WalkT]) -> str:
        """Describe finished walks in few words."""
        return f"{len(walks)} walks"

    def identity(self) -> dict[str, Any]:
        """Plain JSON values that are equal only for equal walks: settings and versions of the code."""
        return {
            "robot": self.robot.fingerprint,
            "world": self.world.model_dump(mode="json"),
            "code": code_versions(),
            **self.settings(),
        }

    @cached_property
    def fingerprint(self) -> str:
        """Digest of the identity, 16 hexadecimal digits."""
        return hashlib.sha256(json.dumps(self.identity(), sort_keys=True).encode()).hexdigest()[:16]


#: Cases, place by place.
Walked = Sequence[tuple[Place[Any, Any], Sequence[Any]]]


def distinct(walked: Walked) -> Walked:
    """Return each place and each of its cases once, in the order in which they come first."""
    places: dict[str, tuple[Place[Any, Any], dict[Any, None]]] = {}
    for place, cases in walked:
        places.setdefault(place.fingerprint, (place, {}))[1].update(dict.fromkeys(cases))
    return [(place, tuple(cases)) for place, cases in places.values()]


class WalkCache:
    """Walks in a folder, one compressed file for each place.

    Attributes:
        notes: one line for each unusable file; its walks are simulated again.
    """

    def __init__(self, folder: Path = FOLDER) -> None:
        self.folder = folder
        self.notes: list[str] = []

    def probe(self) -> None:
        """Raise CacheError, before hours are spent, unless walks can be saved here."""
        if trouble := write_trouble(self.folder):
            raise CacheError(f"study cache: {trouble}")

    def path_of(self, place: Place[CaseT, WalkT]) -> Path:
        """Return the file of a place."""
        return self.folder / f"{place.stem}-{place.fingerprint}.json.gz"

    def load(self, place: Place[CaseT, WalkT]) -> dict[CaseT, WalkT]:
        """Return the saved walks by case; none if the file is missing, damaged or of another place."""
        path = self.path_of(place)
        if not path.exists():
            return {}
        try:
            fingerprint, walks = _adapter(place.WALK).validate_json(gzip.decompress(path.read_bytes()))
            if fingerprint != place.fingerprint:
                raise ValueError("it has the walks of another place")
        except (OSError, EOFError, ValueError, zlib.error) as error:
            self.notes.append(f"{path}: not usable ({damage_reason(error)}); it is computed again")
            return {}
        return {walk.case: walk for walk in walks}

    def save(self, place: Place[CaseT, WalkT], walks: Iterable[WalkT]) -> None:
        """Replace the file of a place; raises CacheError if the disk refuses."""
        path = self.path_of(place)
        kept = [walk for walk in walks if place.keeps(walk)]
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            content = _adapter(place.WALK).dump_json((place.fingerprint, kept))
            atomic_write(path, gzip.compress(content, 1, mtime=0))
        except OSError as error:
            raise CacheError(f"study cache: {path} cannot be written: {error}") from error

    def count(self, walked: Walked) -> tuple[int, int]:
        """Return the number of saved walks, and of all walks."""
        saved = total = 0
        for place, cases in distinct(walked):
            saved += len(self.load(place).keys() & set(cases))
            total += len(cases)
        return saved, total


@cache
def _adapter(walk: type) -> "TypeAdapter[tuple[str, list[Any]]]":
    """What a file holds: the fingerprint of its place, and walks of a class."""
    exact = ConfigDict(ser_json_inf_nan="constants")
    return TypeAdapter(tuple[str, list[walk]], config=exact)  # type: ignore[valid-type]
