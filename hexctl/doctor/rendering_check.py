"""Renderers without a screen, and whether there is a screen."""

import os
import subprocess
import sys
from dataclasses import dataclass

from hexctl.export.render import RENDERERS

#: Maximum time of a graphics library's answer.
TIMEOUT_S = 30.0

#: A separate program: a broken graphics library may kill its process.
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
    """Available renderers: name by `egl` and `osmesa`, or None; and whether there is a screen."""

    renderers: dict[str, str | None]
    display: bool

    @property
    def draws(self) -> bool:
        """Whether it can draw without a screen."""
        return any(name is not None for name in self.renderers.values())


def read_drawing() -> Drawing:
    """Renderers of this computer."""
    return Drawing(
        renderers={name: _renderer(name) for name in RENDERERS},
        display=sys.platform != "linux"
        or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")),
    )


def _renderer(name: str) -> str | None:
    """Name of a library's renderer from a separate process, or None."""
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
