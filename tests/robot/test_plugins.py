"""Modules of the user are found as `python -m` finds them."""

import sys
from pathlib import Path

import pytest

from hexctl.robot.plugins import module_here


def test_a_module_in_the_working_folder_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_robot_parts.py").write_text("ANSWER = 42\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    try:
        assert module_here("my_robot_parts").ANSWER == 42
    finally:
        sys.modules.pop("my_robot_parts", None)


def test_an_error_of_the_import_is_passed_on() -> None:
    with pytest.raises(ModuleNotFoundError, match="no_such_module_here"):
        module_here("no_such_module_here")
