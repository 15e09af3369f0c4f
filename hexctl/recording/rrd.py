"""Rerun's SDK, imported when a recording needs it, and its files (.rrd)."""

import errno
import os
import sys
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from itertools import takewhile
from pathlib import Path
from threading import Thread
from typing import Any, BinaryIO, Self

from hexctl.errors import InputError, MissingExtraError, RecordingError, argument
from hexctl.files import check_new, file_instead

#: Required version of Rerun: each minor version may change the file format.
RERUN = "0.41"

#: Bound on a flush: a disk that hangs must not hang the program.
FLUSH_TIMEOUT_S = 30.0

#: The same on a nearly full disk: a write that does not fit kills Rerun's writer, and a flush may hang.
FULL_TIMEOUT_S = 5.0

#: Less free space than this is nearly full: Rerun writes no more at a time.
FULL_BYTES = 4 * 1024 * 1024

#: Filter of Rerun's messages, read at its import; and its file writer, which warns prematurely.
LOG_VARIABLE, SINK = "RUST_LOG", "re_log_encoding::rrd::file_sink"

#: Source of warnings about unsaved data after a second Ctrl-C.
UNSENT = "re_sdk::log_sink"


def load_rerun() -> Any:
    """The `rerun` module; raises MissingExtraError when it is not installed."""
    try:
        with _without_footer_warnings():
            import rerun
    except ModuleNotFoundError as error:
        raise MissingExtraError("recording", "view") from error
    return rerun


@contextmanager
def _without_footer_warnings() -> Iterator[None]:
    """Suppress warnings of files that get their index when they are closed."""
    if "rerun" in sys.modules:
        yield
        return
    before = os.environ.get(LOG_VARIABLE)
    os.environ[LOG_VARIABLE] = f"{before or 'warn'},{SINK}=off,{UNSENT}=off"
    try:
        yield
    finally:
        # Only for this import: other processes log as they would.
        if before is None:
            del os.environ[LOG_VARIABLE]
        else:
            os.environ[LOG_VARIABLE] = before


class Layout:
    """A layout (blueprint) of Rerun that frees its streams; a context manager.

    Rerun's own stream of a layout refers to itself and would never be freed.
    """

    def __init__(self, blueprint: Any) -> None:
        self._blueprint = blueprint.to_blueprint()
        self._streams: list[Any] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Free the streams after the call has read them."""
        for stream in self._streams:
            stream.disconnect()
        self._streams.clear()

    def to_blueprint(self) -> Self:
        """The layout, for Rerun."""
        return self

    def _log_to_stream(self, stream: Any) -> None:
        self._streams.append(stream)
        self._blueprint._log_to_stream(stream)  # noqa: SLF001  as Rerun would


def save_stream(stream: Any, path: Path, blueprint: Any, *, index: bool = True) -> None:
    """Connect a stream to a file that opens with a layout. An index is kept in memory until it is closed.

    Raises RecordingError for a file that cannot be written, or was deleted since it was made.
    """
    try:
        with Layout(blueprint) as layout:
            stream.save(str(path), default_blueprint=layout, write_footer=index)
    except RuntimeError as error:
        reason = " ".join(str(error).split())
        raise RecordingError(f"{path}: the recording cannot be written ({reason})") from error


@contextmanager
def new_recording(path: Path, application: str, name: str, layout: Any) -> Iterator[Any]:
    """Stream of a file that is written and closed when the block ends; raises RecordingError."""
    stream = load_rerun().RecordingStream(application, recording_id=str(uuid.uuid4()))
    save_stream(stream, path, layout)
    try:
        stream.send_recording_name(name)
        yield stream
        flush(stream, path)
    finally:
        disconnect(stream)


def flush(stream: Any, path: Path) -> None:
    """Write a stream to its file; raises RecordingError if the disk is full or the folder was deleted."""
    with still_there(path):
        room = os.statvfs(path.parent)
    full = room.f_bavail * room.f_frsize < FULL_BYTES
    raised = _bounded(
        partial(stream.flush, timeout_sec=FLUSH_TIMEOUT_S), FULL_TIMEOUT_S if full else 2 * FLUSH_TIMEOUT_S
    )
    if raised is not None:
        reason = " ".join(str(raised).split())
        raise RecordingError(f"{path}: the recording is incomplete; is the disk full? ({reason})") from raised


@contextmanager
def still_there(path: Path) -> Iterator[None]:
    """Raise RecordingError if a recording was deleted while it was written, or cannot be read."""
    try:
        yield
    except FileNotFoundError as error:
        raise RecordingError(f"{path}: the recording was deleted or moved ({error.strerror})") from error
    except OSError as error:
        raise RecordingError(f"{path}: the recording cannot be read ({error.strerror})") from error


def disconnect(stream: Any) -> None:
    """Close a stream, which may lose unflushed data, and free closed ones."""
    _bounded(stream.disconnect, FULL_TIMEOUT_S if stuck() else FLUSH_TIMEOUT_S)
    free_streams()


def free_streams() -> None:
    """Free closed streams, which Rerun keeps, with 4 MB and two threads each; not with `rerun.init`."""
    rr = load_rerun()
    if not stuck() and rr.get_global_data_recording() is None:
        _bounded(rr.bindings.flush_and_cleanup_orphaned_recordings, FULL_TIMEOUT_S)


#: Unreturned calls into Rerun.
_abandoned: list[Thread] = []


def stuck() -> bool:
    """Whether a call into Rerun has not returned: the interpreter could wait for it at its end."""
    return any(thread.is_alive() for thread in _abandoned)


def _bounded(call: Callable[[], object], timeout_s: float) -> Exception | None:
    """Exception of a call, or TimeoutError if it is abandoned. A thread keeps signals working."""
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


#: Rerun recognizes its files by this suffix.
SUFFIX = ".rrd"

#: Rerun 0.41 hangs when layout and scene, which take less than this, do not fit on the disk.
ROOM_BYTES = 500_000


def create_file(path: Path) -> None:
    """Make an empty file and its folders; raises InputError if it exists or cannot be written."""
    check_utf8(path)
    create_folders(path)
    check_new(path, "recording")
    try:
        with path.open("xb") as file:
            _check_room(file, path)
    except OSError as error:
        raise _unwritable(path, error) from error


def create_folders(path: Path) -> None:
    """Make the folders above a recording; raises InputError if they cannot be made."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _unwritable(path, error) from error


def _unwritable(path: Path, error: OSError) -> InputError:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return InputError(
            f"recording: {path} cannot be written: the disk is full; free some space, record elsewhere "
            f"({argument('record')}), or not at all ({argument('no_record')})"
        )
    reason = file_instead(path.parent) or error.strerror
    return InputError(f"recording: {path} cannot be written ({reason}); allowed: a new file")


def _check_room(file: BinaryIO, path: Path) -> None:
    """Raise OSError if the disk has no room for the start of a recording; a failed file is removed."""
    try:
        if hasattr(os, "posix_fallocate"):  # macOS has none; Rerun itself reports a full disk there
            os.posix_fallocate(file.fileno(), 0, ROOM_BYTES)
        os.ftruncate(file.fileno(), 0)
    except BaseException:  # Ctrl-C, too
        path.unlink()
        raise


def check_name(path: Path, what: str = "recording") -> None:
    """Raise InputError for a name that Rerun would not open; `what` is the argument's name in messages."""
    if path.suffix != SUFFIX:
        raise InputError(f"{what}: got {path}; allowed: a name that ends in {SUFFIX}")


def check_utf8(path: Path) -> None:
    """Raise InputError for a path that Rerun cannot open."""
    if os.fsencode(path).decode(errors="replace") != str(path):
        raise InputError(f"recording: got {path}; allowed: a path in UTF-8, for Rerun")


def probe_file(path: Path) -> None:
    """Raise InputError unless `create_file` can make the file; it and its new folders are removed again."""
    check_name(path, argument("record"))
    new = list(takewhile(lambda folder: not folder.exists(), path.parents))
    try:
        create_file(path)
        path.unlink()
    finally:
        for folder in new:
            with suppress(OSError):  # missing, or used by another process
                folder.rmdir()
