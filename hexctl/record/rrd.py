"""Rerun's SDK, imported when a recording needs it, and its files (.rrd)."""

import os
from pathlib import Path
from typing import Any, BinaryIO

from hexctl.errors import InputError, MissingExtraError, RecordingError

#: Longer than this a disk does not need; a hung one must not hang the program.
FLUSH_TIMEOUT_S = 30.0


def load_rerun() -> Any:
    """Return the `rerun` module.

    Raises MissingExtraError when it is not installed.
    """
    try:
        import rerun
    except ImportError as error:
        raise MissingExtraError("recording", "view") from error
    return rerun


def flush(stream: Any, path: Path) -> None:
    """Make sure that everything sent to a stream is in its file.

    Raises RecordingError when the disk did not take it.
    """
    try:
        stream.flush(timeout_sec=FLUSH_TIMEOUT_S)
    except (OSError, RuntimeError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise RecordingError(f"{path}: the recording is incomplete; is the disk full? ({reason})") from error


#: Rerun tells its files by this ending.
SUFFIX = ".rrd"

#: How a whole recording ends, but for a few bytes.
END, END_PADDING = b"RRF2FOOT", 8

#: Rerun 0.41 hangs for good where layout and scene find no room, which is less than this.
ROOM_BYTES = 500_000


def create_file(path: Path) -> None:
    """Make an empty file and the folders above it, because Rerun overwrites an existing one without a word.

    Raises InputError for a file that exists or cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("xb") as file:
            _check_room(file, path)
    except OSError as error:
        if isinstance(error, FileExistsError) and path.exists():
            raise InputError(f"recording: {path} exists; allowed: a new file, nothing is replaced") from None
        raise InputError(
            f"recording: {path} cannot be written ({error.strerror}); allowed: a new file"
        ) from error


def _check_room(file: BinaryIO, path: Path) -> None:
    """Raise OSError where a recording could not even begin, and leave no file then."""
    try:
        os.posix_fallocate(file.fileno(), 0, ROOM_BYTES)
        file.truncate(0)
    except OSError:
        path.unlink()
        raise


def check_whole(path: Path) -> None:
    """Raise RecordingError for a closed recording without its end: Rerun may not say that a disk is full."""
    with path.open("rb") as file:
        file.seek(-min(len(END) + END_PADDING, path.stat().st_size), os.SEEK_END)
        if END not in file.read():
            raise RecordingError(f"{path}: the recording is incomplete; is the disk full?")


def check_name(path: Path) -> None:
    """Raise InputError for a name that Rerun would not open."""
    if path.suffix != SUFFIX:
        raise InputError(f"recording: got {path}; allowed: a name that ends in {SUFFIX}")


def probe_file(path: Path) -> None:
    """Raise InputError unless `create_file` can make the file, which is then removed again; folders stay."""
    check_name(path)
    create_file(path)
    path.unlink()
