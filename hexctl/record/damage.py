"""Damaged recordings at which Rerun's reader would end the whole process, found by another process first."""

import subprocess
import sys
from functools import lru_cache
from pathlib import Path

from hexctl.errors import InputError
from hexctl.record import viewer

#: Recordings of which one process remembers that they are sound.
REMEMBERED = 1024

#: Reads a recording as `hexctl.record.recorded_trial` does.
READ = """
import sys
from rerun.chunk import RrdReader
for chunk in RrdReader(sys.argv[1]).stream().to_chunks():
    chunk.to_record_batch()
"""


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
    limit_s = viewer.time_limit_s(size)
    decodes_all = [str(viewer.viewer_binary()), "rrd", "stats", str(path)]
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
