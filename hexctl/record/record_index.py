"""The index of a recording, written into a finished file by a process of its own."""

import os
import subprocess
from contextlib import suppress
from pathlib import Path

from hexctl.errors import MissingExtraError, RecordingError
from hexctl.files import replacing
from hexctl.record.rrd import SUFFIX, check_whole, has_index
from hexctl.record.viewer import time_limit_s, viewer_binary

#: Other robots may walk on this computer meanwhile.
NICENESS = 10


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
