"""The folder in which stops and clear keys are kept."""

import os
from pathlib import Path


def state_folder() -> Path:
    """Where servers keep their state: what systemd gave, or the user's own folder for it (XDG)."""
    given = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    if given:
        return Path(given)
    home = os.environ.get("XDG_STATE_HOME")
    return (Path(home) if home else Path.home() / ".local" / "state") / "hexctl"
