"""What draws without a screen, and whether there is a screen."""

import os
import subprocess
import sys
from dataclasses import dataclass

from hexctl.export.render import RENDERERS

#: How long a graphics library may take to say what it is.
TIMEOUT_S = 30.0

#: Run as a program of its own: a broken graphics library may end its process.
PROGRAM = """
import os, sys
os.environ["MUJOCO_GL"] = sys.argv[1]
from hexctl.export.render import open_context
context = open_context(16, 16)
from OpenGL import GL
print(GL.glGetString(GL.GL_RENDERER).decode())
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawing:
    """What draws.

    Attributes:
        renderers: by `egl` and `osmesa`, what draws with it, or None where nothing does.
        display: whether a screen is named, where a window could open.
    """

    renderers: dict[str, str | None]
    display: bool

    @property
    def draws(self) -> bool:
        """Whether anything draws without a screen."""
        return any(name is not None for name in self.renderers.values())


def read_drawing() -> Drawing:
    """What draws here."""
    return Drawing(
        renderers={name: _renderer(name) for name in RENDERERS},
        display=sys.platform != "linux"
        or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")),
    )


def _renderer(name: str) -> str | None:
    """What draws with a library, asked in a process of its own; None where nothing does."""
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-c", PROGRAM, name],  # -P: no module of the working folder
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=TIMEOUT_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    lines = done.stdout.strip().splitlines()
    return lines[-1] if lines else None
