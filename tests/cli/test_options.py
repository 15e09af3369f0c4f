"""Options: what `--help` says about each, and the ranges that they check."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from hexctl import cli
from hexctl.cli.main import app, exit_code
from hexctl.cli.options import failure, robot
from hexctl.cli.options.groups import ELSEWHERE, GROUPS, MOST_UNGROUPED, group_of
from hexctl.gait.gait import NAMED_SLOTS, gait_text
from hexctl.robot.configs import config_names
from hexctl.robot.failure import FAILURE_KINDS
from hexctl.types import N_LEGS

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
    assert all(name in robot.ROBOT_HELP for name in config_names("robots"))
    assert all(name in failure.FAILURE_HELP for name in FAILURE_KINDS)
    help_of = {parameter.name: parameter.help for parameter in dict(commands())["hexctl run"].params}
    assert ", ".join(NAMED_SLOTS) in help_of["gait"]


def test_ranges_are_those_of_the_library() -> None:
    assert failure.LEG.high == N_LEGS


def with_groups(group: Any = None, path: str = "hexctl") -> Iterator[tuple[str, list[str]]]:
    """Every command, and group with options of its own, and the names of its options."""
    group = typer.main.get_command(app) if group is None else group
    yield path, [name[2:] for param in group.params for name in param.opts[:1] if name.startswith("--")]
    for name, command in getattr(group, "commands", {}).items():
        yield from with_groups(command, f"{path} {name}")


LONG = {path: options for path, options in with_groups() if len(options) > MOST_UNGROUPED}


def test_the_help_of_a_long_command_has_groups_and_no_option_is_outside() -> None:
    assert {"hexctl run", "hexctl adapt", "hexctl see", "hexctl see twin", "hexctl serve"} <= LONG.keys()
    for path, options in LONG.items():
        outside = [option for option in options if group_of(path.split()[-1], option) is None]
        assert not outside, f"{path}: {outside}; name their group in hexctl/cli/options/groups.py"


def test_options_of_a_connection_are_declared_in_one_module() -> None:
    flags = re.compile(r'"--(connect|listen|device|device-keys|keys|insecure|link)"(?!:)')
    declared = {
        path.relative_to(CLI).as_posix()
        for path in CLI.rglob("*.py")
        for line in path.read_text(encoding="utf-8").splitlines()
        if flags.search(line) and not re.search(r"command|words|OF_BOARD|credentials", line)
    }
    assert declared == {"options/connection.py"}


def test_every_group_is_of_options_that_exist() -> None:
    known = {option for options in LONG.values() for option in options} | {"help"}
    assert {option for options in GROUPS.values() for option in options} <= known
    assert sum(map(len, GROUPS.values())) == len(
        {option for options in GROUPS.values() for option in options}
    )
    for command, options in ELSEWHERE.items():
        path = next(path for path in LONG if path.endswith(f" {command}"))
        assert options.keys() <= set(LONG[path])


@pytest.mark.parametrize("path", LONG)
def test_groups_are_shown(path: str, capsys: pytest.CaptureFixture[str]) -> None:
    flag = "--help-all" if "help-all" in LONG[path] else "--help"
    assert exit_code([*path.split()[1:], flag]) == 0
    shown = re.findall(r"^╭─ ([\w ]+) ─", capsys.readouterr().out, re.MULTILINE)
    groups = {group_of(path.split()[-1], option) for option in (*LONG[path], "help")}
    assert groups <= set(shown)
    assert "Options" not in shown
    assert len(shown) == len(set(shown))


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
