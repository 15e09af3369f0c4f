"""Scratch folders of a process; those of a killed process are removed at the next start.

A folder is locked by its process, and the lock ends with it: a folder without a lock is abandoned.
"""

import fcntl
import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

SUFFIX = ".part"

_NAME = re.compile(rf".+-[0-9a-f]{{8}}{re.escape(SUFFIX)}")

#: Characters of a name in that of a folder, which may have 255 bytes.
MOST_NAME = 50

#: Attempts if a folder is removed just before it is locked.
TRIES = 8

#: Folders that this process has already searched.
_tidied: set[Path] = set()


@contextmanager
def scratch_folder(parent: Path | None = None, name: str = "hexctl") -> Iterator[Path]:
    """A new private folder, hidden in `parent`, removed at the block's end unless moved; raises OSError."""
    place = Path(tempfile.gettempdir()) if parent is None else parent
    remove_abandoned(place)
    folder, lock = _make(place, name if parent is None else f".{name}")
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)


def remove_abandoned(parent: Path) -> None:
    """Remove abandoned scratch folders, once per process and parent."""
    if parent in _tidied:
        return
    _tidied.add(parent)
    try:
        found = [entry.path for entry in os.scandir(parent) if _is_ours(entry)]
    except OSError:
        return
    for path in found:
        lock = _locked(path)
        if lock is not None:
            shutil.rmtree(path, ignore_errors=True)
            os.close(lock)


def _is_ours(entry: os.DirEntry[str]) -> bool:
    return (
        _NAME.fullmatch(entry.name) is not None
        and entry.is_dir(follow_symlinks=False)
        and entry.stat(follow_symlinks=False).st_uid == os.getuid()
    )


def _make(parent: Path, name: str) -> tuple[Path, int]:
    for _ in range(TRIES):
        folder = parent / f"{name[:MOST_NAME]}-{secrets.token_hex(4)}{SUFFIX}"
        folder.mkdir(mode=0o700)
        lock = _locked(str(folder), unlockable=True)
        if lock is not None:
            return folder, lock
    raise FileExistsError(f"{parent}: scratch folders are removed as soon as they are made")


def _locked(path: str, *, unlockable: bool = False) -> int | None:
    """Descriptor that locks a folder, or None; `unlockable` accepts disks without locks."""
    try:
        lock = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except OSError:
        return None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(lock)
        return None
    except OSError:
        if unlockable:
            return lock
        os.close(lock)
        return None
    if os.fstat(lock).st_nlink == 0 or not os.path.isdir(path):
        os.close(lock)
        return None
    return lock
