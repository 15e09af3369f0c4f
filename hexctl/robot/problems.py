"""Say in one line what is wrong with a configuration file: key, value got, what is allowed."""

import math
from collections.abc import Mapping, Sequence
from reprlib import Repr
from typing import Any

import yaml
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

Location = tuple[int | str, ...]

#: What is allowed, by pydantic's type of problem; `{name}` comes from the problem's context.
ALLOWED = {
    "greater_than": "above {gt}",
    "greater_than_equal": "{ge} or more",
    "less_than": "below {lt}",
    "less_than_equal": "{le} or less",
    "finite_number": "a finite number",
    "float_type": "a number",
    "float_parsing": "a number",
    "string_type": "text",
    "string_pattern_mismatch": "text that matches {pattern}",
    "literal_error": "{expected}",
    "model_type": "a mapping of key: value",
    "list_type": "a list",
    "tuple_type": "a list",
    "too_long": "a list of {max_length}",
    "invalid_key": "keys that are text",
}

#: Characters of a value that are shown.
MOST_SHOWN = 160


def shown(value: object) -> str:
    """Return a value as short text on one line, however large it is."""
    short = Repr()
    short.maxlevel, short.maxlist, short.maxstring, short.maxother = 3, 20, 60, 60
    text = short.repr(value)
    return text if len(text) <= MOST_SHOWN else text[:MOST_SHOWN] + "..."


def yaml_problem(error: Exception) -> str:
    """Return what is wrong with a text that is not YAML, and where."""
    mark = getattr(error, "problem_mark", None)
    if isinstance(error, yaml.MarkedYAMLError) and mark is not None:
        return f"line {mark.line + 1}, column {mark.column + 1}: {error.problem}"
    if isinstance(error, RecursionError):
        return "it is nested too deeply"
    return " ".join(str(error).split())


def first_problem(schema: type[BaseModel], error: ValidationError) -> str:
    """Return the first problem of a validation, an unknown key before all others: it explains them."""
    problems = error.errors(include_url=False)
    problem = min(problems, key=lambda problem: problem["type"] != "extra_forbidden")
    more = f" (and {len(problems) - 1} more problems)" if len(problems) > 1 else ""
    return _described(schema, problem) + more


def _described(schema: type[BaseModel], problem: ErrorDetails) -> str:
    key, kind = _dotted(problem["loc"]), problem["type"]
    if kind == "extra_forbidden":
        return f"unknown key {key}; allowed here: {', '.join(_keys_beside(schema, problem['loc']))}"
    if kind == "missing" and isinstance(problem["loc"][-1], int):
        return f"{_dotted(problem['loc'][:-1])}: got {shown(problem['input'])}; allowed: a longer list"
    if kind == "missing":
        return f"{key} is missing; known here: {', '.join(_keys_beside(schema, problem['loc']))}"
    if kind == "value_error":
        return f"{key}: {problem['msg'].removeprefix('Value error, ')}"
    allowed = ALLOWED[kind].format(**problem.get("ctx", {})) if kind in ALLOWED else problem["msg"]
    if isinstance(problem["input"], float) and not math.isfinite(problem["input"]):
        allowed = "a finite number"
    return f"{key}: got {shown(problem['input'])}; allowed: {allowed}"


def _dotted(location: Location) -> str:
    """Return a place in the file as `mounts[0].radius_m`."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location)
    text = text.removeprefix(".") or "the file"
    return text if text.isprintable() else repr(text)


def _keys_beside(schema: type[BaseModel], location: Location) -> Sequence[str]:
    """Return the keys that are allowed where a location's last key stands."""
    here: Any = schema
    for part in location[:-1]:
        fields: Mapping[str, Any] = here.model_fields
        # A place in a list, or a key in a mapping of models, which has been gone into already.
        if isinstance(part, int) or part not in fields:
            continue
        annotation = fields[part].annotation
        inner = [annotation, *getattr(annotation, "__args__", ())]
        here = next((candidate for candidate in inner if hasattr(candidate, "model_fields")), here)
    return sorted(here.model_fields)
