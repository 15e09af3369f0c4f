"""A robot as JSON, with all digits, as in recordings."""

import json
from dataclasses import fields
from typing import Any

import numpy as np

from hexctl.errors import HexctlError, InputError
from hexctl.robot.model import Robot, changed_fields
from hexctl.robot.schema import Body, GaitDefaults, ServoModel

VERSION = 1


def robot_to_json(robot: Robot) -> str:
    """JSON of a robot, from which `robot_from_json` makes an equal one."""
    return json.dumps({"version": VERSION, **_content(robot)})


def robot_from_json(text: str) -> Robot:
    """Robot of `robot_to_json`; raises InputError for anything else."""
    try:
        values = json.loads(text)
        if values.pop("version") != VERSION:
            raise ValueError("another version")
        kinds = {"body": Body, "servo": ServoModel, "gait": GaitDefaults}
        parts = [(name, kind, values.pop(name)) for name, kind in kinds.items()]
        names = {field.name for field in fields(Robot)}
        if not set(values) <= names:
            raise ValueError(f"unknown {', '.join(sorted(set(values) - names))}")
        arrays: dict[str, Any] = {
            name: np.array(value) if isinstance(value, list) else value for name, value in values.items()
        }
        made: dict[str, Any] = {name: part(**_tuples(content)) for name, part, content in parts}
        return Robot(**arrays, **made)
    except (HexctlError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise InputError(f"robot description: {error}; allowed: JSON of this version of hexctl") from error


def _content(part: Any) -> dict[str, Any]:
    content: dict[str, Any] = {}
    for name, value in changed_fields(part):
        if isinstance(value, np.ndarray):
            content[name] = value.tolist()
        elif isinstance(value, (Body, ServoModel, GaitDefaults)):
            content[name] = _content(value)
        else:
            content[name] = value
    return content


def _tuples(values: dict[str, Any]) -> dict[str, Any]:
    return {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
