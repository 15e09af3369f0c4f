"""The Rerun SDK, imported when the first recording needs it."""

from typing import Any

from hexctl.errors import MissingExtraError


def load_rerun() -> Any:
    """Return the `rerun` module.

    Raises MissingExtraError when it is not installed.
    """
    try:
        import rerun
    except ImportError as error:
        raise MissingExtraError("recording", "view") from error
    return rerun
