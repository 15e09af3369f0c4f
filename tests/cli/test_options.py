"""Options: what `--help` says about each, and the ranges that they check."""

import re
from collections.abc import Iterator
from typing import Any, get_args

import pytest
import typer

from hexctl.cli import options
from hexctl.cli.main import app
from hexctl.control.plan import MAX_DURATION_S, SELF_ROTATIONS
from hexctl.gait.gait import MAX_PACE_HZ, NAMED_SLOTS
from hexctl.robot.configs import config_names
from hexctl.robot.failure import FAILURE_KINDS
from hexctl.types import N_LEGS

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
    assert all(name in options.ROBOT_HELP for name in config_names("robots"))
    assert all(name in options.FAILURE_HELP for name in FAILURE_KINDS)
    help_of = {parameter.name: parameter.help for parameter in dict(commands())["hexctl run"].params}
    assert ", ".join(NAMED_SLOTS) in help_of["gait"]


def test_ranges_are_those_of_the_library() -> None:
    assert options.DURATION_S.high == MAX_DURATION_S
    assert options.PACE_HZ.high == MAX_PACE_HZ
    assert options.LEG.high == N_LEGS
    assert get_args(options.SelfRotation) == SELF_ROTATIONS


def test_failed_legs_are_numbers_with_commas_or_auto() -> None:
    assert options.legs_or_auto("2,5") == (2, 5)
    assert options.legs_or_auto("3") == (3,)
    assert options.legs_or_auto("auto") == (options.AUTO_LEG,)
    for text in ("2,9", "", "2,auto", "x"):
        with pytest.raises(typer.BadParameter, match=r"allowed: 1..6, several with commas, auto"):
            options.legs_or_auto(text)
