"""Archives of priors and repertoires: a head in JSON and arrays in one file (.npz), with a digest of both."""

import hashlib
import io
import json
import math
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from hexctl.errors import HexctlError, InputError, argument, check_type
from hexctl.files import OnDamage, atomic_write, read_file

#: Name of the head among the arrays of a file.
_HEAD = "head"

#: Entries of the head in addition to the content.
_ADDED = ("format", "version", "digest")

#: Maximum size of an archive, packed and unpacked; a prior has half a million bytes.
MOST_ARCHIVE_BYTES = 100_000_000

#: Maximum arrays in an archive; a landscape has five.
MOST_ARRAYS = 64

#: Start of the entry of an array in the list of an archive.
_MEMBER = b"PK\x01\x02"

#: Maximum length of a head; that of a prior has some thousand letters.
MOST_HEAD = 1_000_000

#: Bytes of an element when an array is read as numbers.
_NUMBER_BYTES = 8

#: Exceptions of numpy and zipfile for a damaged archive (.npz).
_DAMAGE: tuple[type[Exception], ...] = (
    OSError,
    AttributeError,
    EOFError,
    ValueError,
    KeyError,
    TypeError,
    NotImplementedError,
    zipfile.BadZipFile,
    zlib.error,
    MemoryError,  # an array with a header beyond the memory
    RuntimeError,  # zipfile, for a file marked as encrypted
    tokenize.TokenError,  # numpy, for a truncated array header
)

Arrays = Mapping[str, NDArray[Any]]

Content = TypeVar("Content")


def open_archive(path: Path | str) -> Any:
    """The archive (.npz) of an untrusted file; a context manager.

    Raises OSError as `read_file` does, ValueError if it needs too much memory; other errors for damage.
    """
    data = read_file(Path(path), MOST_ARCHIVE_BYTES)
    if (count := data.count(_MEMBER)) > MOST_ARRAYS:  # zipfile would read the names of all
        raise ValueError(f"it has {count} arrays; allowed: {MOST_ARRAYS}")
    content = io.BytesIO(data)
    with zipfile.ZipFile(content) as packed:
        _check_size(packed)
    content.seek(0)
    return np.load(content, allow_pickle=False)


def damage_reason(error: BaseException) -> str:
    """Why an archive cannot be read, as the end of a message."""
    return " ".join(str(error).split())[:120] or type(error).__name__


def _check_size(packed: zipfile.ZipFile) -> None:
    """Raise ValueError for an archive that would fill the memory; only heads of arrays are unpacked."""
    members = packed.infolist()
    if any(each.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for each in members):
        raise ValueError("it is packed in a way that numpy does not use")
    size = sum(_unpacked_bytes(packed, member) for member in members)
    if size > MOST_ARCHIVE_BYTES:
        raise ValueError(
            f"it unpacks to {size / 1e6:.0f} MB; allowed: up to {MOST_ARCHIVE_BYTES / 1e6:.0f} MB"
        )


def _unpacked_bytes(packed: zipfile.ZipFile, member: zipfile.ZipInfo) -> int:
    """Memory of an array as its head declares it, or as numbers if these take more."""
    with packed.open(member) as file:
        try:
            version = npy.read_magic(file)
        except ValueError:  # numpy does not read it as an array
            return member.file_size
        read_head = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, _, kind = read_head(file)
    return max(member.file_size, math.prod(shape) * max(kind.itemsize, _NUMBER_BYTES))


class ArchiveFileError(HexctlError, OSError):
    """An archive cannot be written."""


def content_digest(head: Mapping[str, Any], arrays: Arrays) -> str:
    """Hash of a head and of arrays as they are stored, in their order."""
    digest = hashlib.sha256(json.dumps(head, sort_keys=True).encode())
    for array in arrays.values():
        digest.update(array.tobytes())
    return digest.hexdigest()[:32]


@dataclass(frozen=True, slots=True, kw_only=True)
class ArchiveKind:
    """A kind of archive, such as `prior`: readable versions, and the command that writes one."""

    name: str
    versions: tuple[int, ...]
    command: str

    @property
    def format(self) -> str:
        """Format in the head of a file."""
        return f"hexctl {self.name}"

    def save(self, path: Path, version: int, head: Mapping[str, Any], arrays: Arrays) -> None:
        """Write an archive atomically; raises ArchiveFileError if the disk refuses."""
        added = {"format": self.format, "version": version, "digest": content_digest(head, arrays)}
        buffer = io.BytesIO()
        packed = np.array(json.dumps({**added, **head}))
        np.savez_compressed(buffer, allow_pickle=False, **{_HEAD: packed}, **arrays)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            atomic_write(path, buffer.getvalue())
        except OSError as error:
            raise ArchiveFileError(f"{self.name}: {path} cannot be written: {error.strerror}") from error

    def read_head(self, path: Path | str) -> dict[str, Any]:
        """Head of a file; raises InputError for a file of another kind or version."""
        return self._read(path, arrays=False)[0]

    def digest(self, path: Path) -> str | None:
        """Digest in the head of a file; None without a file."""
        return str(self.read_head(path)["digest"]) if path.is_file() else None

    def load(
        self, path: Path | str, make: Callable[[dict[str, Any], dict[str, NDArray[Any]]], Content]
    ) -> Content:
        """Content that `make` builds from a file; raises InputError for an unusable or altered file."""
        head, arrays = self._read(path, arrays=True)
        content = {name: value for name, value in head.items() if name not in _ADDED}
        try:
            made = make(head, arrays)
            intact = content_digest(content, arrays) == head["digest"]
        except _DAMAGE as error:
            raise self.refused(path, f"it is damaged ({damage_reason(error)})") from error
        if not intact:
            raise self.refused(path, "it was altered after it was built")
        return made

    def load_of_robot(
        self,
        path: Path,
        name: str,
        fingerprint: str,
        make: Callable[[dict[str, Any], dict[str, NDArray[Any]]], Content],
    ) -> Content:
        """Content of a robot's file; raises InputError without one, or for a file of another robot."""
        if not path.is_file() or self.read_head(path).get("robot_fingerprint") != fingerprint:
            raise InputError(
                f"{self.name}: got robot {name}, which has none; allowed: ant, or {self.command}"
            )
        return self.load(path, make)

    def described(
        self, paths: Iterable[Path], describe: Callable[[Path], dict[str, Any]], on_damage: OnDamage
    ) -> list[dict[str, Any]]:
        """Descriptions of files, with their paths by the name of the kind; damaged files are left out."""
        found = []
        for path in paths:
            try:
                found.append({self.name: str(path), **describe(path)})
            except InputError as error:
                on_damage(error)
        return found

    def refused(self, path: Path | str, why: str) -> InputError:
        """Error for an unusable file."""
        return InputError(f"{self.name} {path}: {why}; allowed: a {self.name} as {self.command} writes it")

    def _read(self, path: Path | str, *, arrays: bool) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        check_type(path, (str, Path), self.name, "the path of a file")
        try:
            with open_archive(path) as file:
                if len(text := str(file[_HEAD])) > MOST_HEAD:
                    raise ValueError(f"its head has more than {MOST_HEAD} letters")
                head = json.loads(text)
                found = {name: file[name] for name in file.files if arrays and name != _HEAD}
        except FileNotFoundError:
            raise InputError(
                f"{argument(self.name)}: no file at {str(path)!r}; allowed: a file of {self.command}"
            ) from None
        except _DAMAGE as error:
            raise self.refused(
                path, f"it is not a {self.name}, or cut off ({damage_reason(error)})"
            ) from error
        if not isinstance(head, dict) or head.get("format") != self.format:
            raise self.refused(path, f"it is not a {self.name}")
        if head.get("version") not in self.versions:
            known = " and ".join(map(str, self.versions))
            raise self.refused(path, f"it has version {head.get('version')}, this hexctl reads {known}")
        return head, found
