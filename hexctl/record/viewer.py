"""Open recordings in Rerun's own viewer."""

import importlib.util
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from hexctl.errors import InputError, MissingExtraError, RecordingError

#: How an .rrd file begins.
MAGIC = b"RRF"

LOCAL = "127.0.0.1"

NO_DISPLAY = "the viewer finds no display"


def open_viewer(paths: Sequence[Path]) -> int:
    """Start the native viewer on recordings, wait until it is closed, and return its exit code.

    Raises InputError for a missing file or a file of another kind, RecordingError for a viewer that cannot
    start, and MissingExtraError without Rerun.
    """
    for path in paths:
        check_recording(path)
    # A port of its own: another viewer that is open keeps what it shows.
    command = [str(viewer_binary()), "--bind", LOCAL, "--port", "auto", *map(str, paths)]
    try:
        viewer = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, errors="replace")
    except OSError as error:
        raise RecordingError(f"{command[0]}: the viewer does not start: {error.strerror}") from error
    with viewer:
        try:
            _, messages = viewer.communicate()
        except BaseException:
            viewer.kill()
            raise
    if viewer.returncode > 0:
        raise RecordingError(_why(messages, paths))
    return viewer.returncode


def newest_recording(folder: Path, *, leave_out: str | None = None) -> Path:
    """Return the recording in a folder, or in the folders below it, that was written last.

    Args:
        folder: where to look.
        leave_out: a file name that does not count.

    Raises InputError when there is none.
    """
    found = [path for path in folder.rglob("*.rrd") if path.is_file() and path.name != leave_out]
    if not found:
        raise InputError(f"no recording (*.rrd) under {folder}; hexctl run writes one")
    return max(found, key=lambda path: (path.stat().st_mtime_ns, path.name))


def check_recording(path: Path) -> None:
    """Raise InputError for a file that is not a recording."""
    try:
        with path.open("rb") as file:
            head = file.read(len(MAGIC))
    except OSError as error:
        raise InputError(f"{path}: cannot be opened: {error.strerror}") from error
    if head != MAGIC:
        raise InputError(f"{path}: is not a Rerun recording; give an .rrd file that hexctl wrote")


def is_recording(path: Path) -> bool:
    """Return whether a file is there and is a recording."""
    try:
        check_recording(path)
    except InputError:
        return False
    return True


def viewer_binary() -> Path:
    """Return Rerun's program itself; the `rerun` on the PATH is a wrapper that would outlive a signal.

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


def check_display() -> None:
    """Raise RecordingError on a machine without a screen, where a window would end without a word."""
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise RecordingError(f"{NO_DISPLAY}; hexctl view --web shows the same in a browser")


def _why(messages: str, paths: Sequence[Path]) -> str:
    """Return one line on why the viewer ended, and what to do where there is no screen."""
    names = " ".join(map(str, paths))
    if any(word in messages for word in ("DISPLAY", "WAYLAND", "neither", "NoDisplay", "XOpenDisplay")):
        return (
            f"{NO_DISPLAY}; hexctl view --web shows the same in a browser; or copy the folder "
            f"of {names} to a machine with one"
        )
    lines = [line.strip() for line in messages.splitlines() if line.strip()]
    last = next((line for line in reversed(lines) if "rror" in line), lines[-1] if lines else "no message")
    return f"the viewer ended with an error: {' '.join(last.split())[:200]}"
