"""References made from the code while the site is built: options of commands, fields of files and results."""

import inspect
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import fields
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import typer
from pydantic import BaseModel
from pydantic.fields import FieldInfo


def commands() -> Iterator[tuple[str, Any]]:
    """Every command, and every group that is one too, with the words that call it."""
    from hexctl.cli.main import app

    yield from _commands_of(typer.main.get_command(app), "hexctl")


def _commands_of(group: Any, path: str) -> Iterator[tuple[str, Any]]:
    for name, command in group.commands.items():
        if not hasattr(command, "commands"):
            yield f"{path} {name}", command
            continue
        if command.params:
            yield f"{path} {name}", command
        yield from _commands_of(command, f"{path} {name}")


def command_reference() -> str:
    """Each command with its arguments and options; those of `--help-all` follow in a folded block."""
    from hexctl.cli.grouped_help import _flags, _text

    parts = []
    for path, command in commands():
        context = command.make_context(path, [], resilient_parsing=True)
        usual, rare = [], []
        for one in command.params:
            if one.name in ("help", "help_all"):
                continue
            is_option = one.param_type_name == "option"
            typed = _flags(one, context) if is_option else one.metavar or one.name.upper()
            (rare if getattr(one, "hidden", False) else usual).append((typed, _text(one, context)))
        summary = (command.help or "").partition("\n\n")[0]
        parts += [f"### {path}", " ".join(summary.split())]
        parts += [_table(("Option", "Meaning"), usual)] if usual else []
        if rare:
            parts += ["Further options, shown by `--help-all`:", _table(("Option", "Meaning"), rare)]
    return "\n\n".join(parts)


def _table(titles: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = ["| " + " | ".join(titles) + " |", "|" + "---|" * len(titles)]
    for first, *rest in rows:
        typed = ", ".join(f"`{part}`" for part in first.split(", "))
        lines.append("| " + " | ".join(_cell(text) for text in (typed, *rest)) + " |")
    return "\n".join(lines)


def _cell(text: str) -> str:
    text = " ".join(text.split())
    text = re.sub(r"(?<![`\w-])(--[a-z][\w-]*)(?!`)", r"`\1`", text) if "`" not in text else text
    return text.replace("|", "\\|").replace("<", "&lt;")


def robot_reference() -> str:
    """Keys of a robot file."""
    from hexctl.robot.schema import RobotSchema

    return _sections({"Keys of a robot file": RobotSchema})


def world_reference() -> str:
    """Keys of a world file, and of a family of worlds."""
    from hexctl.backends.sim.world import DomainRandomization, World

    return _sections({"Keys of a world file": World, "Keys of a family of worlds": DomainRandomization})


def register_reference() -> str:
    """Fields of the registers of bus servos, with the comments that explain them."""
    from hexctl.backends.bus.families import registers

    parts = []
    for kind in (
        registers.RegisterTable,
        registers.Register,
        registers.RequiredValue,
        registers.FactoryValue,
    ):
        texts = _comments(kind) | _attributes(kind)
        rows = [(each.name, f"`{_short(each.type)}`", texts.get(each.name, "")) for each in fields(kind)]
        parts += [f"### {kind.__name__}", _summary(kind), _table(("Field", "Type", "Meaning"), rows)]
    return "\n\n".join(parts)


def _short(kind: Any) -> str:
    """An annotation without the names of modules."""
    return re.sub(r"(\w+\.)+(?=\w)", "", inspect.formatannotation(kind))


def _comments(kind: type) -> dict[str, str]:
    """Comments behind the fields of a dataclass, by name."""
    return dict(re.findall(r"^    (\w+): .*?  # (.+)$", inspect.getsource(kind), re.MULTILINE))


def result_reference() -> str:
    """Keys of a result in JSON and their meaning, and the causes of a walk without progress."""
    from hexctl.control.scoring.cause import CAUSES
    from hexctl.control.trial_result import TrialResult

    texts = _attributes(TrialResult)
    rows = [
        (json_key(field.name), f"`{field.name}`", texts.get(field.name, "")) for field in fields(TrialResult)
    ]
    parts = [
        "### Keys of a trial",
        "In Python they are attributes of `hexctl.run(...).trial`. The object is `hexctl.run(...).outcome`.",
        _table(("Key", "In Python", "Meaning"), rows),
        "### Further keys of a run",
        _table(("Key", "Meaning"), outcome_keys().items()),
        "### Causes of a walk without progress",
        _table(("Cause", "Meaning"), CAUSES.items()),
    ]
    return "\n\n".join(parts)


def outcome_keys() -> dict[str, str]:
    """Meaning of the keys of an outcome besides those of its trial."""
    from hexctl.runs import outcome

    return _attributes(outcome)


#: Keys of JSON that are not the field with degrees in place of radians.
_RENAMED = {
    "turned_rad": "self_rotation_deg",
    "deviation": "deviation_m",
    "true_deviation": "true_deviation_m",
}


def json_key(field: str) -> str:
    """The key in JSON of a field of a result."""
    return _RENAMED.get(field) or re.sub(r"_rad(?=_s$|$)", "_deg", field)


def _sections(roots: dict[str, Any]) -> str:
    """Tables of schemas and of the sections in them, each schema once."""
    waiting, done, parts = [(title, "", schema) for title, schema in roots.items()], set[Any](), []
    while waiting:
        title, path, schema = waiting.pop(0)
        if schema in done:
            continue
        done.add(schema)
        rows = _table(("Key", "Allowed", "Default", "Meaning"), _rows(schema))
        parts += [f"### {title}", _summary(schema), rows]
        below = [
            (f"`{path}{name}`", f"{path}{name}.", one)
            for name, (kind, *_) in _keys(schema).items()
            for one in _schemas(kind)
        ]
        waiting = below + waiting
    return "\n\n".join(parts)


def _rows(schema: Any) -> Iterator[tuple[str, str, str, str]]:
    texts = meanings(schema)
    for names, (kind, marks, default) in _alike(_keys(schema)):
        yield ", ".join(names), allowed(kind, marks), default, texts.get(names[0], "")


def meanings(schema: Any) -> dict[str, str]:
    """Meaning of each key, by the docstrings of a schema and of those it inherits from."""
    found: dict[str, str] = {}
    for owner in reversed(schema.__mro__):
        found |= _attributes(owner)
    return found


def _alike(keys: dict[str, Any]) -> list[tuple[list[str], Any]]:
    """Keys in their order; those of the six legs in one row."""
    rows: list[tuple[list[str], Any]] = []
    for name, value in keys.items():
        if rows and name.startswith("leg") and rows[-1][0][0].startswith("leg") and name[3:4].isdigit():
            rows[-1][0].append(name)
        else:
            rows.append(([name], value))
    return rows


def _keys(schema: Any) -> dict[str, tuple[Any, list[Any], str]]:
    """Type, constraints and default of each key of a pydantic model or dataclass."""
    if isinstance(schema, type) and issubclass(schema, BaseModel):
        found = schema.model_fields
    else:
        found = schema.__pydantic_fields__
    return {name: (one.annotation, list(one.metadata), _default(one)) for name, one in found.items()}


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    parts = value if isinstance(value, tuple | list) else [value]
    if any(part is None or isinstance(part, BaseModel | dict) for part in parts):
        return ""
    return ", ".join(f"{part:.4g}" if isinstance(part, float) else str(part).lower() for part in parts)


def _schemas(kind: Any) -> list[Any]:
    """The schemas in an annotation."""
    if isinstance(kind, type) and (issubclass(kind, BaseModel) or hasattr(kind, "__pydantic_fields__")):
        return [kind]
    return [found for part in get_args(kind) for found in _schemas(part)]


def allowed(kind: Any, marks: Iterable[Any] = ()) -> str:
    """The values that an annotation allows, in words."""
    if get_origin(kind) is Annotated:
        kind, *more = get_args(kind)
        return allowed(kind, [*more, *marks])
    bounds = _bounds(marks)
    if get_origin(kind) in (Union, UnionType):
        kinds = [one for one in get_args(kind) if one is not NoneType]
        return " or ".join(dict.fromkeys(allowed(one, marks) for one in kinds))
    if get_origin(kind) is Literal:
        return ", ".join(map(str, get_args(kind)))
    if get_origin(kind) in (tuple, list):
        parts = [part for part in get_args(kind) if part is not Ellipsis]
        each = allowed(parts[0])
        many = len(parts) > 1 or (get_origin(kind) is tuple and Ellipsis not in get_args(kind))
        return f"{len(parts)} times: {each}" if many else f"list: {each}"
    if get_origin(kind) is dict:
        return "keys with: " + allowed(get_args(kind)[1])
    if _schemas(kind):
        return "section"
    words = {float: "number", int: "whole number", str: "text", bool: "true, false", Any: "any"}
    return bounds or words.get(kind, getattr(kind, "__name__", str(kind)))


def _bounds(marks: Iterable[Any]) -> str:
    low = high = above = below = None
    for mark in _flat(marks):
        above = getattr(mark, "gt", None) if getattr(mark, "gt", None) is not None else above
        low = getattr(mark, "ge", None) if getattr(mark, "ge", None) is not None else low
        high = getattr(mark, "le", None) if getattr(mark, "le", None) is not None else high
        below = getattr(mark, "lt", None) if getattr(mark, "lt", None) is not None else below
    start = f"above {above:g}" if above is not None else f"{low:g}" if low is not None else ""
    end = f"{high:g}" if high is not None else f"below {below:g}" if below is not None else ""
    if start and end:
        return f"{start} to {end}"
    return f"{start} or more" if start and above is None else start or (f"up to {end}" if end else "")


def _flat(marks: Iterable[Any]) -> Iterator[Any]:
    for mark in marks:
        yield from mark.metadata if isinstance(mark, FieldInfo) else (mark,)


def _summary(schema: Any) -> str:
    """First paragraphs of a docstring, without its sections."""
    text = inspect.cleandoc(schema.__doc__ or "")
    return re.split(r"\n(?=Attributes:|Raises )", text)[0].strip()


def _attributes(documented: Any) -> dict[str, str]:
    """Texts of the section `Attributes:` of a docstring, by name."""
    text = inspect.cleandoc(documented.__doc__ or "")
    _, found, body = text.partition("Attributes:\n")
    if not found:
        return {}
    body = body.split("\n\n")[0]
    items = re.split(r"\n(?= {4}\w+: )", "\n" + body)
    pairs = (item.strip().partition(": ") for item in items if item.strip())
    return {name: " ".join(words.split()) for name, _, words in pairs}


#: Generated references, by the name in `<!-- generated: NAME -->`.
PARTS: dict[str, Callable[[], str]] = {
    "commands": command_reference,
    "robot": robot_reference,
    "world": world_reference,
    "registers": register_reference,
    "result": result_reference,
}
