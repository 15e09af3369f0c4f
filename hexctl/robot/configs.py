"""Find and read configuration files: a shipped name or a path to a YAML, always one mapping."""

from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from hexctl.errors import InputError

SchemaT = TypeVar("SchemaT", bound=BaseModel)


def config_root() -> Path:
    """Return the folder of the shipped configuration files, in a wheel or in a checkout."""
    package = Path(__file__).resolve().parent.parent
    installed = package / "configs"
    return installed if installed.is_dir() else package.parent / "configs"


def config_names(kind: str) -> list[str]:
    """Return the shipped names of one kind (`robots`, `worlds`), sorted."""
    return sorted(path.stem for path in (config_root() / kind).glob("*.yaml"))


def find_config(kind: str, name_or_path: str | Path) -> Path:
    """Return the file of a shipped name or of a path; anything with a suffix or a slash is a path.

    Raises InputError that lists the shipped names when there is no such file.
    """
    text = str(name_or_path)
    if Path(text).suffix or "/" in text:
        if Path(text).is_file():
            return Path(text)
        raise InputError(f"no {kind[:-1]} file at {text}; give a YAML file or one of {_listed(kind)}")
    if text in config_names(kind):
        return config_root() / kind / f"{text}.yaml"
    raise InputError(f"unknown {kind[:-1]} {text!r}; allowed: {_listed(kind)}, or a path to a YAML file")


def read_mapping(path: Path) -> dict[str, Any]:
    """Return the one YAML mapping that a file holds; an empty file is an empty mapping.

    Raises InputError for a file that cannot be read, is not YAML, or holds something else.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text: {error}") from error
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        problem = " ".join(str(error).split())[:160]
        raise InputError(f"{path}: is not valid YAML: {problem}") from error
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise InputError(f"{path}: holds a {type(content).__name__}; allowed: a mapping of key: value")
    return content


def validate(schema: type[SchemaT], content: dict[str, Any], path: Path) -> SchemaT:
    """Return the content as the schema's model.

    Raises InputError with file, key, value and what is allowed, for the first thing that is wrong.
    """
    try:
        return schema.model_validate(content)
    except ValidationError as error:
        raise InputError(f"{path}: {_first_problem(schema, error)}") from error


def _first_problem(schema: type[BaseModel], error: ValidationError) -> str:
    """Describe the first problem of a validation in one line."""
    problems = error.errors(include_url=False)
    problem = problems[0]
    key = ".".join(str(part) for part in problem["loc"]) or "the file"
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    if problem["type"] == "extra_forbidden":
        return f"unknown key {key}; allowed here: {', '.join(_siblings(schema, problem['loc']))}{more}"
    if problem["type"] == "missing":
        return f"{key} is missing{more}"
    message = problem["msg"].removeprefix("Value error, ")
    if problem["type"] == "value_error":
        return f"{key}: {message}{more}"
    shown = repr(problem["input"])
    shown = shown if len(shown) <= 60 else shown[:57] + "..."
    return f"{key}: got {shown}; allowed: {message[0].lower()}{message[1:]}{more}"


def _siblings(schema: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """Return the keys that are allowed where an unknown key stands."""
    here: Any = schema
    for part in location[:-1]:
        if isinstance(part, int):
            continue
        annotation = here.model_fields[part].annotation
        here = next(
            (
                inner
                for inner in [annotation, *getattr(annotation, "__args__", ())]
                if hasattr(inner, "model_fields")
            ),
            here,
        )
    return sorted(here.model_fields)


def _listed(kind: str) -> str:
    return ", ".join(config_names(kind))
