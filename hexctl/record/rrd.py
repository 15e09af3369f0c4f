"""Rerun's SDK, imported when a recording needs it, and its files (.rrd)."""

import os
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from itertools import takewhile
from pathlib import Path
from threading import Thread
from typing import Any, BinaryIO

from hexctl.errors import InputError, MissingExtraError, RecordingError

#: Bound on a flush: a disk that hangs must not hang the program.
FLUSH_TIMEOUT_S = 30.0

#: The same where the disk is nearly full: Rerun's writer dies of a write that does not fit, and a flush may
#: then wait for it for ever.
FULL_TIMEOUT_S = 5.0

#: A disk with less room than this is nearly full: more than Rerun writes at once.
FULL_BYTES = 4 * 1024 * 1024


def load_rerun() -> Any:
    """The `rerun` module.

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
    room = os.statvfs(path.parent)
    full = room.f_bavail * room.f_frsize < FULL_BYTES
    raised = _bounded(
        partial(stream.flush, timeout_sec=FLUSH_TIMEOUT_S), FULL_TIMEOUT_S if full else 2 * FLUSH_TIMEOUT_S
    )
    if raised is not None:
        reason = " ".join(str(raised).split())
        raise RecordingError(f"{path}: the recording is incomplete; is the disk full? ({reason})") from raised


def disconnect(stream: Any) -> None:
    """Close a stream, which may lose what was not flushed."""
    _bounded(stream.disconnect, FULL_TIMEOUT_S if _abandoned else FLUSH_TIMEOUT_S)


#: Calls into Rerun that have not come back.
_abandoned: list[Thread] = []


def stuck() -> bool:
    """Whether a call into Rerun has not come back: the interpreter could then wait for it when it ends."""
    return any(thread.is_alive() for thread in _abandoned)


def _bounded(call: Callable[[], object], timeout_s: float) -> Exception | None:
    """What a call raised, or TimeoutError when it has not come back in time; it is then left behind.

    It runs on a thread of its own, so that signals are heard meanwhile.
    """
    raised: list[Exception] = []

    def run() -> None:
        try:
            call()
        except (OSError, RuntimeError, ValueError) as error:
            raised.append(error)

    thread = Thread(target=run, name="rerun", daemon=True)
    thread.start()
    thread.join(timeout_s)
    if thread.is_alive():
        _abandoned.append(thread)
        return TimeoutError(f"no answer in {timeout_s:g} s")
    return raised[0] if raised else None


#: Rerun recognises its files by this suffix.
SUFFIX = ".rrd"

#: A whole recording ends with this, up to a few bytes.
END, END_PADDING = b"RRF2FOOT", 8

#: Rerun 0.41 hangs when layout and scene, which take less than this, do not fit on the disk.
ROOM_BYTES = 500_000


def create_file(path: Path) -> None:
    """Make an empty file and the folders above it: Rerun itself would overwrite an existing file silently.

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
    """Raise OSError, and remove the file, when the disk has no room for the start of a recording."""
    try:
        os.posix_fallocate(file.fileno(), 0, ROOM_BYTES)
        file.truncate(0)
    except OSError:
        path.unlink()
        raise


def check_whole(path: Path) -> None:
    """Raise RecordingError for a closed recording without its end: Rerun may not report a full disk."""
    with path.open("rb") as file:
        file.seek(-min(len(END) + END_PADDING, path.stat().st_size), os.SEEK_END)
        if END not in file.read():
            raise RecordingError(f"{path}: the recording is incomplete; is the disk full?")


def check_name(path: Path) -> None:
    """Raise InputError for a name that Rerun would not open."""
    if path.suffix != SUFFIX:
        raise InputError(f"recording: got {path}; allowed: a name that ends in {SUFFIX}")


def probe_file(path: Path) -> None:
    """Raise InputError unless `create_file` can make the file; it and its new folders are removed again."""
    check_name(path)
    new = list(takewhile(lambda folder: not folder.exists(), path.parents))
    try:
        create_file(path)
        path.unlink()
    finally:
        for folder in new:
            with suppress(OSError):  # not made, or another process has put something there meanwhile
                folder.rmdir()
