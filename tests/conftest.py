"""Set up before anything is imported: no display, and hypothesis without deadlines or luck."""

import os

from hypothesis import settings

os.environ.setdefault("MUJOCO_GL", "disable")

settings.register_profile("hexctl", deadline=None, derandomize=True)
settings.load_profile("hexctl")
