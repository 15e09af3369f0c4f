"""Removes the incomplete recording of a killed process or an interrupted walk when its session is resumed.

A note in the session's folder names the file: only a file of this name is removed.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hexctl.adapt.sessions.search_session import Session
from hexctl.files import atomic_write, read_file
from hexctl.waiting import StopRequested, never

NOTE = "unfinished"

#: Longest note that is read.
MOST_BYTES = 300

#: Names that hexctl gives to recordings of a session.
_NAME = re.compile(r"(trial-\d{3,}|baseline-[a-z]+)(-\d+)?\.rrd")


@contextmanager
def unfinished(path: Path, interrupted: StopRequested = never) -> Iterator[None]:
    """Note that a recording is being written in this block; the note stays if the walk was interrupted."""
    with suppress(OSError):  # the walk matters more; a disk that is full is reported for its recording
        atomic_write(path.with_name(NOTE), path.name)  # a link at its place is replaced, not followed
    try:
        yield
    finally:
        if not interrupted():
            with suppress(OSError):
                path.with_name(NOTE).unlink()


def remove_unfinished(folder: Path, session: Session) -> Path | None:
    """Remove the recording of a killed or interrupted walk of a held session; the file, or None."""
    try:
        name = read_file(folder / NOTE, MOST_BYTES).decode("ascii")
        if _NAME.fullmatch(name) is None:
            return None
        path = folder / name
        (folder / NOTE).unlink()
        kept = [walk.recording_in(folder) for walk in (*session.trials, *session.baseline)]
        if path in kept or path.is_symlink():
            return None
        path.unlink()
    except (OSError, ValueError):
        return None
    return path
