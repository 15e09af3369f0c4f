"""Rerun's program, and what it does with finished recordings: it finds damage, and writes the index."""

import hashlib
import importlib.metadata
import importlib.util
import logging
import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from hexctl.errors import InputError, MissingExtraError, RecordingError
from hexctl.files import atomic_write, read_file, replacing
from hexctl.recording.rrd import SUFFIX, check_whole, has_index

_LOG = logging.getLogger(__name__)

#: What is told of each recording that is left out.
OnDamage = Callable[[InputError], object]

#: What a process of Rerun may take to go through a recording: a start, and so long for each byte. One of an
#: hour takes 30 s.
START_S, BYTES_PER_S = 60.0, 500_000.0

#: Other robots may walk on this computer meanwhile.
NICENESS = 10

#: Recordings that one process looks at.
TOGETHER = 32

#: Name of the check, changed with it: what an earlier one found sound is looked at again.
CHECK = "hexctl 2"

#: For the exit code of a program that did not start, as a shell has it.
DID_NOT_START = 127

#: Recordings that are known to be sound, 65 bytes each; of more than these the older half is forgotten.
MOST_KNOWN = 10_000

#: Reads a recording as `hexctl.recording.recorded_trial` does.
READ = """
import sys
from rerun.chunk import RrdReader
for chunk in RrdReader(sys.argv[1]).stream().to_chunks():
    chunk.to_record_batch()
"""


def viewer_binary() -> Path:
    """Path of Rerun's executable; the `rerun` on the PATH is a wrapper that does not pass signals on.

    Raises MissingExtraError when it is not installed.
    """
    try:
        package = importlib.util.find_spec("rerun_cli")
    except ValueError:
        package = None
    if package is None or package.origin is None:
        raise MissingExtraError("the viewer", "view")
    folder = Path(package.origin).parent
    for name in ("rerun", "rerun.exe"):
        if (folder / name).is_file():
            return folder / name
    raise MissingExtraError("the viewer", "view")


class _State(NamedTuple):
    """A file, and what changes when something else is written to it."""

    path: Path
    size: int
    changed_ns: int
    inode: int

    @classmethod
    def of(cls, path: Path) -> "_State | None":
        """State of a file; None for one that is not there."""
        try:
            state = path.stat()
        except OSError:
            return None
        return cls(path.absolute(), state.st_size, state.st_mtime_ns, state.st_ino)


#: Whether a recording that was looked at ends the process that reads it.
_ends_reader: dict[_State, bool] = {}


def check_sound(path: Path) -> None:
    """Raise InputError for a recording whose damage would end the process that reads it.

    What Rerun refuses with an error of its own passes, and a file that is not there. A file that has not
    changed is looked at only once, and a content that was read to its end not again by any process.

    Raises MissingExtraError without Rerun.
    """
    state = _State.of(path)
    if state is None:
        return
    if state not in _ends_reader:
        _look_at_unknown([state])
    if _ends_reader[state]:
        raise InputError(
            f"recording: {path} is damaged, and Rerun cannot read it; "
            "allowed: a recording that hexctl run made"
        )


def log_damage(error: InputError) -> None:
    """Log what is wrong with a recording that is left out."""
    _LOG.warning("left out: %s", error)


def look_at(paths: Iterable[Path]) -> None:
    """Look at recordings for `check_sound`, many in one process: one process for each takes longer.

    Raises MissingExtraError without Rerun.
    """
    states = dict.fromkeys(map(_State.of, paths))
    _look_at_unknown([state for state in states if state is not None and state not in _ends_reader])


def _look_at_unknown(states: Sequence[_State]) -> None:
    """Look at files of which this process knows nothing, but for contents that were found sound before."""
    known, digests = set(_known_digests()), {state: _digest(state.path) for state in states}
    _ends_reader.update({state: False for state, digest in digests.items() if digest in known})
    unknown = [state for state in states if state not in _ends_reader]
    sound: list[_State] = []
    for start in range(0, len(unknown), TOGETHER):
        sound += _look_at(unknown[start : start + TOGETHER])
    # Of a file that is written meanwhile it is not known which content was looked at.
    _keep_digests([digest for state in sound if (digest := digests[state]) and digest == _digest(state.path)])


def _known_path() -> Path:
    """Where it is kept what is sound: with the user, for a folder of recordings must not vouch for itself."""
    home = os.environ.get("XDG_CACHE_HOME")
    return (Path(home) if home else Path.home() / ".cache") / "hexctl" / "sound-recordings"


def _known_digests() -> list[str]:
    """Digests of contents that are known to be sound, the oldest first; none where they cannot be read."""
    try:
        return read_file(_known_path(), 100 * MOST_KNOWN).decode("ascii", "replace").split()
    except (OSError, RuntimeError):  # a user without a home
        return []


def _digest(path: Path) -> str | None:
    """Digest of a recording's content, the check and the version of Rerun; None where there is none."""
    try:
        head = f"{CHECK}, rerun {importlib.metadata.version('rerun-sdk')}:".encode()
        if not path.is_file():
            return None
        with path.open("rb") as file:
            return hashlib.file_digest(file, lambda: hashlib.blake2b(head, digest_size=32)).hexdigest()
    except (OSError, importlib.metadata.PackageNotFoundError):
        return None


def _keep_digests(digests: Sequence[str]) -> None:
    """Add digests of contents that were found sound; a disk that takes none costs another look."""
    known = _known_digests()
    kept = known[-MOST_KNOWN // 2 :] if len(known) + len(digests) > MOST_KNOWN else known
    with suppress(OSError, RuntimeError):
        if digests:
            _known_path().parent.mkdir(parents=True, exist_ok=True)
            atomic_write(_known_path(), "".join(f"{digest}\n" for digest in (*kept, *digests)))


def _look_at(states: Sequence[_State]) -> list[_State]:
    """Remember which of some files end their reader, or take too long; these are found by halves.

    Returns the files that were read to their end. What passes besides, for a process that did not start or
    failed for a reason of its own, is known to this process alone.
    """
    if _decodes(states):
        _ends_reader.update(dict.fromkeys(states, False))
        return list(states)
    if len(states) > 1:
        middle = len(states) // 2
        return _look_at(states[:middle]) + _look_at(states[middle:])
    (state,) = states
    # The reader goes other ways than that program, and reads some files that it refuses.
    code = _exit_code([sys.executable, "-P", "-c", READ, str(state.path)], time_limit_s(state.size))
    _ends_reader[state] = code is None or code < 0
    return [state] if code == 0 else []


def _decodes(states: Sequence[_State]) -> bool:
    """Whether Rerun's program decodes all of some files, or refuses them without ending before its time."""
    command = [str(viewer_binary()), "rrd", "stats", *(str(state.path) for state in states)]
    return _exit_code(command, time_limit_s(sum(state.size for state in states))) == 0


def _exit_code(command: list[str], limit_s: float, niceness: int = 0) -> int | None:
    """Exit code of a command, negative for a signal, `DID_NOT_START`, or None if it takes too long."""
    silent = subprocess.DEVNULL
    try:
        # In a session of its own: Ctrl-C, which ends it, would be taken for damage.
        process = subprocess.Popen(
            command, stdin=silent, stdout=silent, stderr=silent, start_new_session=True
        )
    except OSError:
        return DID_NOT_START
    try:
        if niceness:
            with suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, process.pid, niceness)
        return process.wait(limit_s)
    except subprocess.TimeoutExpired:
        return None
    finally:
        process.kill()
        process.wait()


def write_index(path: Path) -> bool:
    """Rewrite a closed recording with an index, and in fewer and larger pieces: a third of its size.

    Returns whether it has one now. Where Rerun fails, as on a full disk, and after Ctrl-C, the file is as it
    was: the walk is done, and its result is not lost for an index.
    """
    try:
        if has_index(path):
            return True
        with replacing(path) as draft:
            named = draft.with_suffix(SUFFIX)  # which Rerun asks for
            try:
                _optimize(path, named)
                check_whole(named)
                named.replace(draft)
            finally:
                named.unlink(missing_ok=True)
        state = _State.of(path)
        if state is not None:
            _ends_reader[state] = False  # Rerun has just read all of it
    except (OSError, MissingExtraError, RecordingError, KeyboardInterrupt):
        return False
    return True


def _optimize(path: Path, draft: Path) -> None:
    """Have Rerun write a recording once more.

    Raises RecordingError where it fails, hangs or does not start.
    """
    command = [str(viewer_binary()), "rrd", "optimize", str(path), "-o", str(draft)]
    if _exit_code(command, time_limit_s(path.stat().st_size), NICENESS) != 0:
        raise RecordingError(f"{path}: Rerun writes no index")


def time_limit_s(size_bytes: int) -> float:
    """Time after which a process of Rerun that goes through a recording of a size hangs."""
    return START_S + size_bytes / BYTES_PER_S
