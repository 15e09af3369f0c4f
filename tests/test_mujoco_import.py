"""MuJoCo is imported even if `MUJOCO_GL` names a library that does not load."""

import os
from pathlib import Path

import pytest

from hexctl.mujoco_import import import_undrawn

BROKEN = "import os\nif os.environ['MUJOCO_GL'] != 'disable':\n    raise AttributeError('glGetError')\n"


def test_a_broken_graphics_library_stops_no_import(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "draws.py").write_text(BROKEN)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    assert import_undrawn("draws").__name__ == "draws"
    assert os.environ["MUJOCO_GL"] == "osmesa"
