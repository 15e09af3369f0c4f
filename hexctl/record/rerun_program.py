"""Rerun's program, and what it does with finished recordings: it finds damage, and writes the index."""

import importlib.util
import os
import subprocess
import sys
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

from hexctl.errors import InputError, MissingExtraError, RecordingError
from hexctl.files import replacing
from hexctl.record.rrd import SUFFIX, check_whole, has_index

#: What a process of Rerun may take to go through a recording: a start, and so long for each byte. One of an
#: hour takes 30 s.
START_S, BYTES_PER_S = 60.0, 500_000.0

#: Other robots may walk on this computer meanwhile.
NICENESS = 10

#: Recordings of which one process remembers that they are sound.
REMEMBERED = 1024

#: Reads a recording as `hexctl.record.recorded_trial` does.
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


def check_sound(path: Path) -> None:
    """Raise InputError for a recording whose damage would end the process that reads it.

    What Rerun refuses with an error of its own passes, and a file that is not there. A file that has not
    changed is looked at only once.

    Raises MissingExtraError without Rerun.
    """
    try:
        state = path.stat()
    except OSError:
        return
    if _ends_reader(path.absolute(), state.st_size, state.st_mtime_ns, state.st_ino):
        raise InputError(
            f"recording: {path} is damaged, and Rerun cannot read it; "
            "allowed: a recording that hexctl run made"
        )


@lru_cache(maxsize=REMEMBERED)
def _ends_reader(path: Path, size: int, _changed_ns: int, _inode: int) -> bool:
    """Whether Rerun's reader ends the process that reads a recording, or takes too long."""
    limit_s = time_limit_s(size)
    decodes_all = [str(viewer_binary()), "rrd", "stats", str(path)]
    if _exit_code(decodes_all, limit_s) == 0:
        return False
    # The reader goes other ways than that program, and reads some files that it refuses.
    code = _exit_code([sys.executable, "-P", "-c", READ, str(path)], limit_s)
    return code is None or code < 0


def _exit_code(command: list[str], limit_s: float) -> int | None:
    """Exit code of a command, negative for a signal, 1 where it does not start; None if it takes too long."""
    silent = subprocess.DEVNULL
    try:
        done = subprocess.run(
            command, stdin=silent, stdout=silent, stderr=silent, timeout=limit_s, check=False
        )
    except subprocess.TimeoutExpired:
        return None
    except OSError:
        return 1
    return done.returncode


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
    except (OSError, MissingExtraError, RecordingError, subprocess.SubprocessError, KeyboardInterrupt):
        return False
    return True


def _optimize(path: Path, draft: Path) -> None:
    """Have Rerun write a recording once more.

    Raises SubprocessError when it fails or hangs, OSError when it does not start.
    """
    command = [str(viewer_binary()), "rrd", "optimize", str(path), "-o", str(draft)]
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, process.pid, NICENESS)
        code = process.wait(time_limit_s(path.stat().st_size))
    except BaseException:
        process.kill()
        process.wait()
        raise
    if code != 0:
        raise subprocess.CalledProcessError(code, command)


def time_limit_s(size_bytes: int) -> float:
    """Time after which a process of Rerun that goes through a recording of a size hangs."""
    return START_S + size_bytes / BYTES_PER_S
