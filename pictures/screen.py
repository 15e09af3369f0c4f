"""A virtual screen: an X server, and a home folder other than the user's."""

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hexctl.recording.viewer import viewer_binary
from pictures.needed import MissingProgramError

#: Where programs keep what they remember, instead of HOME.
KEPT_BY_XDG = ("XDG_CONFIG_HOME", "XDG_DATA_HOME", "XDG_CACHE_HOME", "XDG_STATE_HOME", "XDG_RUNTIME_DIR")


@contextmanager
def virtual_screen(window: tuple[int, int]) -> Iterator[str]:
    """Run an X server on a free display until the block ends, and yield the display's name.

    Its screen is more than twice as wide and high as a window: the pointer, which stands in the middle, shall
    not be in the window and make it show what lies under it.

    Raises MissingProgramError where it is not installed or does not start.
    """
    program = shutil.which("Xvfb")
    if program is None:
        raise MissingProgramError("Xvfb")
    read_end, write_end = os.pipe()
    width, height = (2 * side + 100 for side in window)
    server = subprocess.Popen(
        [
            program,
            *("-displayfd", str(write_end)),
            *("-screen", "0", f"{width}x{height}x24"),
            *("-nolisten", "tcp"),
        ],
        pass_fds=[write_end],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(write_end)
    try:
        with os.fdopen(read_end) as pipe:
            number = pipe.readline().strip()
        if not number:
            raise MissingProgramError("an Xvfb that starts")
        yield f":{number}"
    finally:
        server.terminate()
        try:
            server.wait(10)
        except subprocess.TimeoutExpired:
            server.kill()
            server.wait()


@contextmanager
def strange_home() -> Iterator[dict[str, str]]:
    """Environment with an empty home folder and without Rerun's usage statistics."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as home:
        variables = {name: value for name, value in os.environ.items() if name not in KEPT_BY_XDG}
        variables |= {"HOME": home, "XDG_RUNTIME_DIR": home, "LC_ALL": "C.UTF-8"}
        Path(home).chmod(0o700)
        subprocess.run(
            [str(viewer_binary()), "analytics", "disable"], env=variables, check=True, capture_output=True
        )
        yield variables
