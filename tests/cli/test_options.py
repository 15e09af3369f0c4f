"""What `--help` says to somebody who has never seen hexctl: each option, its unit, range and default."""

import re
from collections.abc import Iterator
from typing import Any

import pytest
import typer

from hexctl.cli.main import app

#: What an option or argument that takes a number says about it.
RANGE = re.compile(r"\d\.\.\d|or more|above 0|any number")
UNIT = re.compile(
    r"second|metre|degree|\bday|fraction|gait cycles|leg that failed|trials|threads|runs|worlds|whole number",
    re.IGNORECASE,
)


def commands(group: Any = None, path: str = "hexctl") -> Iterator[tuple[str, Any]]:
    """Return every command with the words that call it."""
    group = typer.main.get_command(app) if group is None else group
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, f"{path} {name}")
        else:
            yield f"{path} {name}", command


def is_number(parameter: Any) -> bool:
    return parameter.type_descriptor.annotation in (int, float)


PARAMETERS = [(path, parameter) for path, command in commands() for parameter in command.params]


@pytest.mark.parametrize(
    ("path", "parameter"), PARAMETERS, ids=[f"{path} {parameter.name}" for path, parameter in PARAMETERS]
)
def test_every_option_says_what_it_is(path: str, parameter: Any) -> None:
    said = parameter.help or ""
    assert said.endswith((".", ")")), f"no sentence: {said!r}"
    assert "As in hexctl" not in said
    if parameter.param_type_name == "option" and not parameter.is_flag and path != "hexctl view":
        assert parameter.default is not None or "(default:" in said, f"no default: {said!r}"
    if is_number(parameter):
        assert RANGE.search(said), f"no range: {said!r}"
        assert UNIT.search(said), f"no unit: {said!r}"


def test_there_are_numbers_among_them() -> None:
    assert sum(is_number(parameter) for _path, parameter in PARAMETERS) > 20


@pytest.mark.parametrize(("path", "command"), list(commands()), ids=lambda value: str(value)[:30])
def test_every_command_says_in_one_sentence_what_it_does(path: str, command: Any) -> None:
    first = (command.help or "").split("\n\n")[0]
    assert first.endswith("."), path
    assert len(first) <= 110, path


def test_commands_are_listed_in_groups_beginning_with_a_walk() -> None:
    group: Any = typer.main.get_command(app)
    assert list(group.commands)[:2] == ["run", "adapt"]
    assert all(command.rich_help_panel for command in group.commands.values())
