"""Options: what `--help` says about each, and the ranges that they check."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from hexctl import cli
from hexctl.cli.grouped_help import MOST_UNGROUPED
from hexctl.cli.main import app, exit_code
from hexctl.gait.gait import NAMED_SLOTS, gait_text
from hexctl.robot.configs import config_names
from hexctl.robot.failure import FAILURE_KINDS

CLI = Path(cli.__file__).parent

#: What an option or argument that takes a number says about it.
RANGE = re.compile(r"\d\.\.\d|or more|above 0|any finite number")
UNIT = re.compile(
    r"second|metre|kilogram|degree|\bday|fraction|gait cycles|"
    r"leg that failed|trials|threads|runs|worlds|whole number",
    re.IGNORECASE,
)


def commands(group: Any = None, path: str = "hexctl") -> Iterator[tuple[str, Any]]:
    """Every command with the words that call it."""
    group = typer.main.get_command(app) if group is None else group
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, f"{path} {name}")
        else:
            yield f"{path} {name}", command


def is_number(parameter: Any) -> bool:
    return parameter.type_descriptor.annotation in (int, float)


@pytest.mark.parametrize(("path", "command"), list(commands()), ids=lambda value: str(value)[:30])
def test_every_command_and_option_says_what_it_is(path: str, command: Any) -> None:
    first = (command.help or "").split("\n\n")[0]
    assert first.endswith(".")
    assert len(first) <= 110
    for parameter in command.params:
        said = parameter.help or ""
        name = f"{path} {parameter.name}: {said!r}"
        assert said.endswith((".", ")")), f"no sentence: {name}"
        assert "As in hexctl" not in said, name
        if parameter.param_type_name == "option" and not parameter.is_flag and path != "hexctl view":
            assert parameter.default is not None or "(default:" in said, f"no default: {name}"
        if is_number(parameter):
            assert RANGE.search(said), f"no range: {name}"
            assert UNIT.search(said), f"no unit: {name}"


def test_there_are_numbers_among_them() -> None:
    assert sum(is_number(parameter) for _path, command in commands() for parameter in command.params) > 20


def test_commands_are_listed_in_groups_beginning_with_a_walk() -> None:
    group: Any = typer.main.get_command(app)
    assert list(group.commands)[:2] == ["run", "adapt"]
    assert all(command.rich_help_panel for command in group.commands.values())


def test_names_in_help_texts_are_those_that_exist() -> None:
    help_of = {parameter.name: parameter.help for parameter in dict(commands())["hexctl run"].params}
    assert all(name in help_of["robot"] for name in config_names("robots"))
    assert all(name in help_of["failure"] for name in FAILURE_KINDS)
    assert ", ".join(NAMED_SLOTS) in help_of["gait"]


def with_groups(group: Any = None, path: str = "hexctl") -> Iterator[tuple[str, list[str]]]:
    """Every command, and group with options of its own, and the names of its options."""
    group = typer.main.get_command(app) if group is None else group
    yield path, [name[2:] for param in group.params for name in param.opts[:1] if name.startswith("--")]
    for name, command in getattr(group, "commands", {}).items():
        yield from with_groups(command, f"{path} {name}")


LONG = {path: options for path, options in with_groups() if len({*options} - {"help-all"}) > MOST_UNGROUPED}


@pytest.mark.parametrize("path", LONG)
def test_a_long_command_shows_its_options_in_groups(path: str, capsys: pytest.CaptureFixture[str]) -> None:
    flag = "--help-all" if "help-all" in LONG[path] else "--help"
    assert exit_code([*path.split()[1:], flag]) == 0
    shown = re.findall(r"^([\w ]+):$", capsys.readouterr().out, re.MULTILINE)
    assert len(shown) == len(set(shown)) > 1
    assert "Options" not in shown


@pytest.mark.parametrize(
    ("typed", "gait"),
    [("1,4,1,4,1,4", "tripod"), (" 1, 4,1,4,1,4", "tripod"), ("Wave", "wave"), ("57", "57"),
     ("5,1,2,4,3,6", "5,1,2,4,3,6"), ("1,1,1,1,1,1", "1,1,1,1,1,1")],
)  # fmt: skip
def test_slots_that_are_printed_for_a_gait_may_be_typed(typed: str, gait: str) -> None:
    assert gait_text(typed) == gait


def test_help_leaves_out_what_help_all_shows(capsys: pytest.CaptureFixture[str]) -> None:
    for flag, shown in (("--help", False), ("--help-all", True)):
        assert exit_code(["run", flag]) == 0
        printed = capsys.readouterr().out
        assert "--gait" in printed
        assert ("--swing-share" in printed) is shown
