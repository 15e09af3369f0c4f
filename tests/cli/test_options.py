"""Options of all commands: their help, their ranges, and the ways to ask for help."""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, get_origin

import pytest
import typer

from hexctl.cli.commands import COMMANDS
from hexctl.cli.grouped_help import MOST_UNGROUPED
from hexctl.cli.main import app
from hexctl.cli.suggestions import SYNONYMS
from hexctl.errors import InputError, WrongTypeError
from hexctl.options import (
    RARE,
    UNTYPED,
    Option,
    Panel,
    Range,
    Typed,
    check_fields,
    check_names,
    check_used,
    options_of,
)
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
            err = call(*path.split()[1:], f"--{option.flag}", f"{bad:.15g}", code=2).err
            assert err.startswith(f"hexctl: --{option.flag}: got ")


@EVERY
def test_what_is_no_number_or_no_choice_is_refused_with_its_flag(path: str, command: Any, call: Call) -> None:
    for parameter in typed_options(command.params):
        bad = ["x", "nan"] if is_number(parameter) else []
        bad += ["no-such-word"] if get_origin(parameter.type_descriptor.annotation) is Literal else []
        for value in bad:
            err = call(*path.split()[1:], parameter.opts[0], value, code=2).err
            assert err.startswith(f"hexctl: {parameter.opts[0]}: got ")


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where a thing is."""

    PANEL: ClassVar = "Connection"

    connect: str | None = None
    """Where it is."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Thing(Place):
    """What a thing does."""

    PANEL: ClassVar = "Walk"

    pace_hz: Annotated[float, Range(low=0, high=10, above=True), RARE] = 1.0
    """Cycles per second, {}."""

    turn_rad: Annotated[float | None, Range(low=-90, high=90, degrees=True), Typed(flag="turn")] = None
    """Degrees to turn, {}."""

    mode: Annotated[Literal["auto", "none"], Panel("Other")] = "auto"
    """What it holds."""

    inner: Annotated[int, UNTYPED] = 0
    """Only for Python."""

    connect: str | None = "here"
    """Where this one is."""


def test_own_options_come_first_each_with_its_flag_group_and_range() -> None:
    found = [(one.name, one.flag, one.panel, one.rare) for one in options_of(Thing)]
    assert found == [
        ("pace_hz", "pace", "Walk", True),
        ("turn_rad", "turn", "Walk", False),
        ("mode", "mode", "Other", False),
        ("connect", "connect", "Connection", False),
    ]
    texts = {one.name: one.text for one in options_of(Thing)}
    assert texts["pace_hz"] == "Cycles per second, above 0 up to 10."
    assert texts["connect"] == "Where this one is."


@pytest.mark.parametrize(
    ("fields", "error", "named"),
    [
        ({"pace_hz": 11.0}, InputError, "pace_hz"),
        ({"pace_hz": "1"}, WrongTypeError, "pace_hz"),
        ({"pace_hz": True}, WrongTypeError, "pace_hz"),
        ({"turn_rad": 3.0}, InputError, "turn_rad"),
        ({"mode": "line"}, InputError, "mode"),
        ({"connect": 5}, WrongTypeError, "connect"),
        ({"inner": 1.5}, WrongTypeError, "inner"),
    ],
)
def test_a_value_that_its_type_does_not_allow_is_refused(
    fields: dict[str, object], error: type[InputError], named: str
) -> None:
    with pytest.raises(error, match=f"^{named}: got"):
        check_fields(Thing(**fields))  # type: ignore[arg-type]


def test_an_option_that_nothing_uses_is_refused_unless_it_is_its_default() -> None:
    check_used(Thing(), ("pace_hz", "connect"), "with a robot")
    with pytest.raises(InputError, match=r"^pace_hz: got 2; allowed: with a robot$"):
        check_used(Thing(pace_hz=2.0), ("pace_hz", "connect"), "with a robot")


def make(*, stop: bool = False, **options: float) -> None:  # noqa: ARG001
    check_names(make, options, Thing)


def test_a_keyword_that_is_no_field_is_refused_with_the_nearest_one() -> None:
    make(pace_hz=2, stop=True)
    with pytest.raises(InputError, match=r"^make: got pace; allowed: .*, stop; did you mean 'pace_hz'\?$"):
        make(pace=2)
