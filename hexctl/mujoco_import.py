"""Imports MuJoCo, of which only pictures need the library that `MUJOCO_GL` names."""

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any


def import_undrawn(name: str) -> Any:
    """Import a module; if its graphics library fails, import it without one."""
    try:
        return import_module(name)
    except Exception:  # noqa: BLE001  missing or broken libraries raise anything
        wanted = os.environ.get("MUJOCO_GL")
        os.environ["MUJOCO_GL"] = "disable"
        try:
            return import_module(name)
        finally:
            if wanted is None:
                del os.environ["MUJOCO_GL"]
            else:
                os.environ["MUJOCO_GL"] = wanted


if TYPE_CHECKING:
    import mujoco as mujoco
else:
    mujoco = import_undrawn("mujoco")
