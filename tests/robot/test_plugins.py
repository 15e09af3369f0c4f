"""Modules of the user are found as `python -m` finds them."""

import sys
from pathlib import Path

import pytest

from hexctl.robot.plugins import load_named, module_here


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


def test_what_a_script_has_defined_is_given_from_python() -> None:
    continued = r"of the script that began .*: hexctl.Adaptation.resume\(NAME, optimizer=Mine\).run"
    with pytest.raises(ImportError, match=continued):
        load_named("__main__:Mine", "optimizer")
    assert load_named("hexctl.robot.plugins:load_named", "optimizer") is load_named
