"""Cache of landscapes on disk: one file each, replaced as a whole and checked when it is read."""

import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import IO

import numpy as np

from hexctl.control.trial_result import STATUSES
from hexctl.errors import HexctlError
from hexctl.files import ARCHIVE_DAMAGE, damage_reason, open_archive, replacing
from hexctl.study.landscapes.landscape import NUMBERS, Landscape, LandscapeSpec, empty_landscape

#: Where the commands keep landscapes, below the working directory.
FOLDER = Path("runs/study-cache")

_ARRAYS = ("codes", "status", "numbers", "paths_m")


class CacheError(HexctlError, OSError):
    """The cache folder cannot be written."""


class LandscapeCache:
    """Landscapes in a folder, by robot, world, failure, trial settings and code version.

    A landscape may be saved before it is complete; `Landscape.missing` names the gaits it lacks.

    Attributes:
        folder: where the files are.
        notes: what is wrong with files, one line each; such landscapes are simulated again.
    """

    def __init__(self, folder: Path = FOLDER) -> None:
        self.folder = folder
        self.notes: list[str] = []

    def probe(self) -> None:
        """Raise CacheError, before hours are spent, unless landscapes can be saved here."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            probe = self.folder / f".probe.{os.getpid()}"
            probe.touch()
            probe.unlink()
        except OSError as error:
            raise CacheError(f"study cache: {self.folder} cannot be written: {error.strerror}") from error

    def path_of(self, spec: LandscapeSpec) -> Path:
        """File of a landscape."""
        return self.folder / f"leg{spec.leg}-{spec.self_rotation}-{spec.fingerprint}.npz"

    def load(self, spec: LandscapeSpec) -> Landscape:
        """Landscape as saved; without any gait when there is no usable file."""
        path = self.path_of(spec)
        if not path.exists():
            return empty_landscape(spec)
        try:
            return _read(path, spec)
        except ARCHIVE_DAMAGE as error:
            self.notes.append(f"{path}: not usable ({damage_reason(error)}); it is computed again")
            return empty_landscape(spec)

    def count(self, specs: Iterable[LandscapeSpec]) -> tuple[int, int]:
        """Number of gaits saved, and of all gaits, of some landscapes."""
        landscapes = [self.load(spec) for spec in specs]
        saved = sum(int(landscape.done.sum()) for landscape in landscapes)
        return saved, sum(len(landscape.codes) for landscape in landscapes)

    def save(self, landscape: Landscape) -> None:
        """Replace the file of a landscape atomically.

        Raises CacheError when the disk refuses.
        """
        path = self.path_of(landscape.spec)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with replacing(path) as draft, draft.open("wb") as file:
                _write(file, landscape)
        except OSError as error:
            raise CacheError(f"study cache: {path} cannot be written: {error}") from error


def _write(file: IO[bytes], landscape: Landscape) -> None:
    identity = json.dumps(landscape.spec.identity(), sort_keys=True)
    arrays = {name: getattr(landscape, name) for name in _ARRAYS}
    np.savez(file, allow_pickle=False, identity=np.array(identity), **arrays)


def _read(path: Path, spec: LandscapeSpec) -> Landscape:
    """Landscape of a file; raises ValueError unless it belongs to this spec and its values are possible."""
    with open_archive(path) as file:
        if json.loads(str(file["identity"])) != json.loads(json.dumps(spec.identity())):
            raise ValueError("it is of another landscape")
        arrays = {name: file[name] for name in _ARRAYS}
    expected = empty_landscape(spec)
    for name, array in arrays.items():
        wanted = getattr(expected, name)
        if (array.shape, array.dtype) != (wanted.shape, wanted.dtype):
            raise ValueError(f"{name} is {array.dtype} {array.shape}, expected {wanted.dtype} {wanted.shape}")
    landscape = Landscape(spec=spec, **arrays)
    _check(landscape)
    return landscape


def _check(landscape: Landscape) -> None:
    """Raise ValueError for codes, statuses or numbers that no simulation gives."""
    if not np.array_equal(landscape.codes, landscape.spec.codes):
        raise ValueError("its codes are others")
    if not np.isin(landscape.status, ["", *STATUSES]).all():
        raise ValueError(f"it has statuses other than {', '.join(STATUSES)}")
    known = [NUMBERS.index(name) for name in ("signed_m", "mean_m", "max_m", "distance_m")]
    if not np.isfinite(landscape.numbers[landscape.valid][:, known]).all():
        raise ValueError("it has valid gaits without numbers")
