"""Configuration files: found by shipped name or path, read as a mapping, and checked by a schema."""

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, TypeVar, dataclass_transform, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass
from pydantic_core import ErrorDetails

from hexctl.errors import InputError, check_type, shown
from hexctl.files import is_file, is_folder, read_file
from hexctl.robot.yaml_text import yaml_content
from hexctl.typed_names import known_name, nearest

SchemaT = TypeVar("SchemaT")


def _not_a_switch(value: object) -> object:
    """Refuse YAML's yes, no, on, off, true and false, which pydantic would convert to 1 and 0."""
    if isinstance(value, bool):
        raise ValueError(f"got {value}; allowed: a number")
    return value


#: Maximum size of a configuration file; the shipped ones have some thousand bytes.
MOST_BYTES = 500_000

Number = Annotated[float, BeforeValidator(_not_a_switch)]
Whole = Annotated[int, BeforeValidator(_not_a_switch)]
Length = Annotated[Number, Field(gt=0, le=10, allow_inf_nan=False)]
Coordinate = Annotated[Number, Field(ge=-10, le=10, allow_inf_nan=False)]
Mass = Annotated[Number, Field(gt=0, le=1000, allow_inf_nan=False)]
Positive = Annotated[Number, Field(gt=0, allow_inf_nan=False)]
AngleDeg = Annotated[Number, Field(ge=-360, le=360, allow_inf_nan=False)]
Fraction = Annotated[Number, Field(gt=0, le=1, allow_inf_nan=False)]


def config_root() -> Path:
    """Folder of the shipped configuration files, in a wheel or in a checkout."""
    package = Path(__file__).resolve().parent.parent
    installed = package / "configs"
    return installed if installed.is_dir() else package.parent / "configs"


def config_names(kind: str) -> list[str]:
    """Shipped names of one kind (`robots`, `worlds`), sorted."""
    return sorted(path.stem for path in (config_root() / kind).glob("*.yaml"))


def find_config(kind: str, name_or_path: str | Path) -> Path:
    """File of a shipped name, in any spelling, or of a path; raises InputError with the shipped names."""
    check_type(name_or_path, (str, os.PathLike), kind[:-1], "a shipped name or the path of a YAML file")
    text = str(name_or_path)
    if Path(text).suffix or "/" in text:
        if is_file(Path(text)):
            return Path(text)
        what = f"{text!r} is a folder" if is_folder(Path(text)) else f"no {kind[:-1]} file at {text!r}"
        raise InputError(f"{what}; allowed: a YAML file, or one of {_listed(kind)}")
    if (name := known_name(text, config_names(kind))) is not None:
        return config_root() / kind / f"{name}.yaml"
    if text and is_folder(Path(text)):
        raise InputError(f"{text!r} is a folder; allowed: a YAML file, or one of {_listed(kind)}")
    near = nearest(text, config_names(kind))
    raise InputError(
        f"unknown {kind[:-1]} {text!r}; allowed: {_listed(kind)}, or a path to a YAML file{near}"
    )


def shipped_text(kind: str, name_or_path: str | Path) -> str:
    """Canonical spelling of a shipped name: `Randomized:07` is `randomised:7`; a path as it is."""
    text = str(name_or_path)
    name, colon, number = text.rpartition(":") if ":" in text else (text, "", "")
    known = known_name(name, config_names(kind)) if not ("/" in text or Path(text).suffix) else None
    if known is None or not colon:
        return known or text
    return f"{known}:{int(number)}" if number.isdecimal() and not is_file(Path(text)) else text


def read_mapping(path: Path) -> dict[str, Any]:
    """The YAML mapping of a file, empty for an empty file; raises InputError for anything else."""
    try:
        return mapping_of(read_file(path, MOST_BYTES), path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read as text: {error}") from error


def mapping_of(content: bytes, path: Path) -> dict[str, Any]:
    """The YAML mapping of a file's content; raises what `read_mapping` raises, naming its path."""
    if b"<robot" in content or b"<mujoco" in content:
        raise InputError(
            f"{path}: got a URDF or an MJCF; allowed: a YAML file; next: hexctl robot import {path} -o "
            "FILE.yaml"
        )
    try:
        values = yaml_content(content.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: cannot be read as text: {error}") from error
    except ValueError as error:
        raise InputError(f"{path}: is not valid YAML: {error}") from error
    if values is None:
        return {}
    if not isinstance(values, dict):
        raise InputError(f"{path}: got {shown(values)}; allowed: a mapping of key: value")
    return values


def validate(schema: type[SchemaT], content: dict[str, Any], path: Path) -> SchemaT:
    """Content of a file as an instance of its schema; raises InputError for the first problem."""
    try:
        return TypeAdapter(schema).validate_python(content)
    except ValidationError as error:
        raise InputError(f"{path}: {first_problem(schema, error)}") from error


def is_family(content: Mapping[str, Any]) -> bool:
    """Whether the content of a world file is a family of numbered worlds."""
    return "ranges" in content


def _listed(kind: str) -> str:
    names = config_names(kind)
    families = [name for name in names if is_family(read_mapping(config_root() / kind / f"{name}.yaml"))]
    return ", ".join([*(name for name in names if name not in families), *(f"{name}:N" for name in families)])


Location = tuple[int | str, ...]

#: Allowed values by pydantic's type of problem; `{name}` comes from the problem's context.
ALLOWED = {
    "greater_than": "above {gt}",
    "greater_than_equal": "{ge} or more",
    "less_than": "below {lt}",
    "less_than_equal": "{le} or less",
    "finite_number": "a finite number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "int_parsing": "a whole number",
    "int_parsing_size": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "string_type": "text",
    "string_too_long": "text of at most {max_length} characters",
    "string_pattern_mismatch": "text that matches {pattern}",
    "literal_error": "{expected}",
    "model_type": "a mapping of key: value",
    "dataclass_type": "a mapping of key: value",
    "list_type": "a list",
    "tuple_type": "a list",
    "too_long": "a list of {max_length}",
    "too_short": "a list of {min_length}",
    "invalid_key": "text keys",
}


#: Problem types of an unknown key of a model or a dataclass.
UNKNOWN_KEY = ("extra_forbidden", "unexpected_keyword_argument")


def first_problem(schema: type, error: ValidationError) -> str:
    """First problem of a validation; an unknown key comes first, because others may follow from it."""
    problems = error.errors(include_url=False)
    problem = min(problems, key=lambda problem: problem["type"] not in UNKNOWN_KEY)
    others = len(problems) - 1
    more = f" (and {others} more problem{'s' if others > 1 else ''})" if others else ""
    return _described(schema, problem) + more


def _described(schema: type, problem: ErrorDetails) -> str:
    key, kind = _dotted(problem["loc"]), problem["type"]
    if kind in UNKNOWN_KEY:
        beside = _keys_beside(schema, problem["loc"])
        return (
            f"unknown key {key}{nearest(str(problem['loc'][-1]), beside)}; allowed here: {', '.join(beside)}"
        )
    if kind == "missing" and isinstance(problem["loc"][-1], int):
        return f"{_dotted(problem['loc'][:-1])}: got {shown(problem['input'])}; allowed: a longer list"
    if kind in ("missing", "missing_keyword_only_argument"):
        return f"{key} is missing; known here: {', '.join(_keys_beside(schema, problem['loc']))}"
    if kind == "value_error":
        return f"{key}: {problem['msg'].removeprefix('Value error, ')}"
    allowed = ALLOWED[kind].format(**problem.get("ctx", {})) if kind in ALLOWED else problem["msg"]
    if isinstance(problem["input"], float) and not math.isfinite(problem["input"]):
        allowed = "a finite number"
    long = problem.get("ctx", {}).get("actual_length") if kind in ("too_long", "too_short") else None
    got = shown(problem["input"]) if long is None else f"a list of {long}"
    from hexctl.robot.units import likely_unit  # only refusals need it

    likely = likely_unit(problem["loc"], problem["input"])
    return f"{key}: got {got}; allowed: {allowed}" + (f"; {likely}" if likely else "")


def _dotted(location: Location) -> str:
    """Location in the file, such as `mounts[0].radius_m`."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location)
    text = text.removeprefix(".") or "the file"
    return text if text.isprintable() else repr(text)


def keys_of(schema: Any) -> Mapping[str, Any] | None:
    """Fields of a pydantic model or dataclass by name; None for any other type."""
    return getattr(schema, "__pydantic_fields__", None)


def _keys_beside(schema: type, location: Location) -> Sequence[str]:
    here: Any = schema
    for part in location[:-1]:
        fields: Mapping[str, Any] = here.__pydantic_fields__
        # An index of a list, or a key of a mapping of models: the model is already that of its elements.
        if isinstance(part, int) or part not in fields:
            continue
        here = section_in(fields[part].annotation) or here
    return sorted(here.__pydantic_fields__)


def section_in(annotation: Any) -> type | None:
    """The first pydantic model or dataclass in an annotation, or None."""
    if isinstance(annotation, type) and keys_of(annotation) is not None:
        return annotation
    return next((found for part in get_args(annotation) if (found := section_in(part))), None)


class Section(BaseModel):
    """A section of a robot file; unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


PartT = TypeVar("PartT")


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(field,))
def file_part(key: str) -> Callable[[type[PartT]], type[PartT]]:
    """Frozen dataclass for a section of the file and a part of the model; a call raises InputError."""

    def decorate(kind: type[PartT]) -> type[PartT]:
        made: Any = dataclass(frozen=True, kw_only=True, config=ConfigDict(extra="forbid"))(kind)
        checked = made.__init__

        @wraps(checked)
        def init(self: PartT, **values: Any) -> None:
            try:
                checked(self, **values)
            except ValidationError as error:
                raise InputError(f"{key}: {first_problem(made, error)}") from None

        made.__init__ = init
        decorated: type[PartT] = made
        return decorated

    return decorate
