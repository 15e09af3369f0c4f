"""Options of all commands: their help, their ranges, and the ways to ask for help."""

import math
import re
from collections.abc import Iterator
from typing import Any, Literal, get_origin

import pytest
import typer

from hexctl.cli.grouped_help import MOST_UNGROUPED
from hexctl.cli.main import COMMANDS, app
from hexctl.cli.suggestions import SYNONYMS
from hexctl.gait.gait import NAMED_SLOTS
from hexctl.options import Option, Range
from hexctl.robot.configs import config_names
from hexctl.robot.failure import FAILURE_KINDS
from tests.cli.conftest import Call

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


def typed_options(parameters: list[Any]) -> list[Any]:
    return [one for one in parameters if one.param_type_name == "option" and one.opts[0].startswith("--")]


EVERY = pytest.mark.parametrize(("path", "command"), list(commands()), ids=lambda value: str(value)[:30])


@EVERY
def test_every_command_and_option_says_what_it_is(path: str, command: Any) -> None:
    first = (command.help or "").split("\n\n")[0]
    assert first.endswith(".")
    assert len(first) <= 110
    for parameter in command.params:
        said = parameter.help or ""
        name = f"{path} {parameter.name}: {said!r}"
        assert said.endswith((".", ")")), f"no sentence: {name}"
        if parameter.param_type_name == "option" and not parameter.is_flag and path != "hexctl view":
            assert parameter.default is not None or "(default:" in said, f"no default: {name}"
        if is_number(parameter):
            assert RANGE.search(said), f"no range: {name}"
            assert UNIT.search(said), f"no unit: {name}"


def fields_of(command: Any) -> tuple[Option, ...]:
    """Fields of the dataclass whose options a command has."""
    unused = getattr(command.callback, "unused", None)
    return () if unused is None else tuple(unused.args[1])


def outside(allowed: Range) -> list[float]:
    """Values beyond the ends of a range."""
    ends = [allowed.low if allowed.above else allowed.low - 1, allowed.high + 1]
    return [end for end in ends if math.isfinite(end)]


@EVERY
def test_every_range_of_a_field_is_read_and_refused_beyond_with_its_flag(
    path: str, command: Any, call: Call
) -> None:
    flags = {flag for one in command.params for flag in one.opts}
    for option in fields_of(command):
        assert f"--{option.flag}" in flags
        if option.range is None:
            continue
        good = option.range.high if math.isfinite(option.range.high) else option.range.low + 1
        good = 1 if math.isinf(good) else good
        context = command.make_context(path, [f"--{option.flag}", f"{good:.15g}"], resilient_parsing=True)
        field = math.radians(good) if option.range.degrees else good
        assert context.params[option.name] == pytest.approx(field)
        for bad in outside(option.range):
            assert call(*path.split()[1:], f"--{option.flag}", f"{bad:.15g}", code=2).err.startswith(
                f"hexctl: --{option.flag}: got "
            )


@EVERY
def test_what_is_no_number_or_no_choice_is_refused_with_its_flag(path: str, command: Any, call: Call) -> None:
    for parameter in typed_options(command.params):
        bad = ["x", "nan"] if is_number(parameter) else []
        bad += ["no-such-word"] if get_origin(parameter.type_descriptor.annotation) is Literal else []
        for value in bad:
            assert call(*path.split()[1:], parameter.opts[0], value, code=2).err.startswith(
                f"hexctl: {parameter.opts[0]}: got "
            )


def test_names_in_help_texts_are_those_that_exist() -> None:
    help_of = {parameter.name: parameter.help for parameter in dict(commands())["hexctl run"].params}
    assert all(name in help_of["robot"] for name in config_names("robots"))
    assert all(name in help_of["failure"] for name in FAILURE_KINDS)
    assert ", ".join(NAMED_SLOTS) in help_of["gait"]
    assert all(command.panel for command in COMMANDS.values())


def with_groups(group: Any = None, path: str = "hexctl") -> Iterator[tuple[str, list[str]]]:
    """Every command, and group with options of its own, and the names of its options."""
    group = typer.main.get_command(app) if group is None else group
    yield path, [name[2:] for param in group.params for name in param.opts[:1] if name.startswith("--")]
    for name, command in getattr(group, "commands", {}).items():
        yield from with_groups(command, f"{path} {name}")


LONG = {path: options for path, options in with_groups() if len({*options} - {"help-all"}) > MOST_UNGROUPED}


@pytest.mark.parametrize("path", LONG)
def test_a_long_command_shows_its_options_in_groups(path: str, call: Call) -> None:
    flag = "--help-all" if "help-all" in LONG[path] else "--help"
    shown = re.findall(r"^([\w ]+):$", call(*path.split()[1:], flag).out, re.MULTILINE)
    assert len(shown) == len(set(shown)) > 1
    assert "Options" not in shown


def test_help_leaves_out_what_help_all_shows(call: Call) -> None:
    for flag, shown in (("--help", False), ("--help-all", True)):
        printed = call("run", flag).out
        assert "--gait" in printed
        assert ("--swing-share" in printed) is shown


@pytest.mark.parametrize("asked", [["-h"], ["help"], ["run", "-h"], ["help", "sim", "board"]])
def test_help_is_asked_for_in_any_usual_way(asked: list[str], call: Call) -> None:
    assert "Usage: hexctl" in call(*asked).out


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        ("stpo", "'estop'"),
        ("run mine.yaml", "--robot mine.yaml"),
        ("adapt --failed-leg 5 lukas", "--robot lukas"),
        ("drive wave", "--gait wave"),
        ("sessions rm x", "'delete'"),
        *((words, None) for words in ("xyzzy", "rm", "run xyzzy", "estop phantomx")),
    ],
)
def test_what_may_have_been_meant_is_proposed(words: str, meant: str | None, call: Call) -> None:
    said = call(words, code=2).err
    assert ("did you mean" in said.lower()) is (meant is not None)
    assert meant is None or meant in said


def test_proposed_commands_exist() -> None:
    meant = {command.split()[0] for command in SYNONYMS.values()}
    assert meant <= COMMANDS.keys() | {"list", "delete", "copy"}
    assert not SYNONYMS.keys() & COMMANDS.keys()
