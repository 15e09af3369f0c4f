"""Modules of the user are found as `python -m` finds them."""

import sys
from pathlib import Path

import pytest

from hexctl.errors import InputError
from hexctl.robot.plugins import load_named, made_of, module_here


def test_a_module_in_the_working_folder_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_robot_parts.py").write_text("ANSWER = 42\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    try:
        assert module_here("my_robot_parts").ANSWER == 42
    finally:
        sys.modules.pop("my_robot_parts", None)


def test_what_a_script_has_defined_is_given_from_python() -> None:
    with pytest.raises(ImportError):
        load_named("__main__:Mine", "optimizer")
    assert load_named("hexctl.robot.plugins:load_named", "optimizer") is load_named


@pytest.mark.parametrize("name", ["ours", f"{__name__}:Counted", f"{__name__}:MADE"])
def test_a_class_of_ones_own_is_made_as_a_shipped_one_is(name: str) -> None:
    assert isinstance(made_of(name, {"ours": Counted}, Counted, "policy"), Counted)


@pytest.mark.parametrize(
    ("name", "named"),
    [
        ("hope", "policy"),
        ("no.such.module:Hope", "policy"),
        (f"{__name__}:Nothing", "policy"),
        ("pathlib:Path", "pathlib:Path"),
    ],
)
def test_what_is_not_of_the_kind_is_refused(name: str, named: str) -> None:
    with pytest.raises(InputError, match=named):
        made_of(name, {"ours": Counted}, Counted, "policy")


class Counted:
    """Something that can be made."""


MADE = Counted()
