"""Find and read configuration files: a shipped name or a path to a YAML, always one mapping."""

from pathlib import Path
from typing import Annotated, Any, TypeVar

import yaml
from pydantic import BaseModel, BeforeValidator, ValidationError

from hexctl.errors import InputError
from hexctl.robot.problems import first_problem, shown, yaml_problem

SchemaT = TypeVar("SchemaT", bound=BaseModel)


def _not_a_switch(value: object) -> object:
    """Refuse YAML's yes, no, on, off, true and false, which Python would count as 1 and 0."""
    if isinstance(value, bool):
        raise ValueError(f"got {value}; allowed: a number")
    return value


#: A number of a configuration file.
Number = Annotated[float, BeforeValidator(_not_a_switch)]


class _Loader(yaml.SafeLoader):
    """Plain YAML without tags of its own, which refuses a key that is given twice."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue
            if key.value in seen:
                raise yaml.constructor.ConstructorError(
                    problem=f"the key {shown(key.value)} is given twice", problem_mark=key.start_mark
                )
            seen.add(key.value)
        return super().construct_mapping(node, deep)


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
        if _is_file(text):
            return Path(text)
        raise InputError(f"no {kind[:-1]} file at {text!r}; allowed: a YAML file, or one of {_listed(kind)}")
    if text in config_names(kind):
        return config_root() / kind / f"{text}.yaml"
    raise InputError(f"unknown {kind[:-1]} {text!r}; allowed: {_listed(kind)}, or a path to a YAML file")


def read_mapping(path: Path) -> dict[str, Any]:
    """Return the one YAML mapping that a file holds; an empty file is an empty mapping.

    Raises InputError for a file that cannot be read, is not YAML, or holds something else.
    """
    try:
        content = yaml.load(path.read_text(encoding="utf-8"), Loader=_Loader)  # noqa: S506  a SafeLoader
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text: {error}") from error
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise InputError(f"{path}: is not valid YAML: {yaml_problem(error)}") from error
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise InputError(f"{path}: got {shown(content)}; allowed: a mapping of key: value")
    return content


def validate(schema: type[SchemaT], content: dict[str, Any], path: Path) -> SchemaT:
    """Return the content as the schema's model.

    Raises InputError with file, key, value and what is allowed, for the first thing that is wrong.
    """
    try:
        return schema.model_validate(content)
    except ValidationError as error:
        raise InputError(f"{path}: {first_problem(schema, error)}") from error


def _is_file(text: str) -> bool:
    """Return whether a path names a file; one that the system cannot even look up does not."""
    try:
        return Path(text).is_file()
    except (OSError, ValueError):
        return False


def _listed(kind: str) -> str:
    return ", ".join(config_names(kind))
