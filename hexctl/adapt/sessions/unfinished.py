"""Removes the incomplete recording of a killed process when its session is resumed.

A note in the session's folder names the file and its inode: no other file is ever removed.
"""

import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hexctl.adapt.sessions.search_session import Session
from hexctl.files import read_file

NOTE = "unfinished"

#: Longest note that is read.
MOST_BYTES = 300

#: Names that hexctl gives to recordings of a session.
_NAME = re.compile(r"(trial-\d{3,}|baseline-[a-z]+)(-\d+)?\.rrd")


@contextmanager
def unfinished(path: Path) -> Iterator[None]:
    """Note that a recording is being written in this block, in which `note_created` is called."""
    _write(path.with_name(NOTE), path.name)
    try:
        yield
    finally:
        with suppress(OSError):
            path.with_name(NOTE).unlink()


def note_created(path: Path) -> None:
    """Add the recording's file to the note."""
    with suppress(OSError):  # it was deleted already
        _write(path.with_name(NOTE), f"{path.name} {path.stat().st_ino}")


def remove_unfinished(folder: Path, session: Session) -> Path | None:
    """Remove the recording of a killed trial of a session that must be held; the file, or None."""
    try:
        name, inode = _noted(folder)
        path = folder / name
        found = path.lstat()
        (folder / NOTE).unlink()
        walks = (*session.trials, *session.baseline)
        kept = any(walk.recording is not None and Path(walk.recording).name == name for walk in walks)
        if kept or not stat.S_ISREG(found.st_mode) or (inode or found.st_ino) != found.st_ino:
            return None
        path.unlink()
    except (OSError, ValueError):
        return None
    return path


def _noted(folder: Path) -> tuple[str, int]:
    """Name and inode of a note, 0 if the file was not made yet; raises OSError or ValueError without one."""
    name, _, inode = read_file(folder / NOTE, MOST_BYTES).decode("ascii").partition(" ")
    if _NAME.fullmatch(name) is None:
        raise ValueError("it names no recording of a session")
    return name, int(inode or 0)


def _write(note: Path, content: str) -> None:
    """Write a note, not through a link, which could lead anywhere."""
    with suppress(OSError):  # the walk matters more; a disk that is full is reported for its recording
        note.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(
            note, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_NONBLOCK, 0o644
        )
        with open(descriptor, "w", encoding="ascii") as file:
            file.write(content)
