"""dm_control, imported without a display."""

import os

if "DISPLAY" not in os.environ:
    # Nothing here renders; without this, dm_control warns about the missing display at import.
    os.environ.setdefault("MUJOCO_GL", "disable")

from dm_control import mjcf

__all__ = ["mjcf"]
