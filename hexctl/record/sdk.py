"""The Rerun SDK, imported when the first recording needs it."""

from pathlib import Path
from typing import Any

from hexctl.errors import MissingExtraError, RecordingError

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
