"""A robot as JSON, with all digits, as in recordings and on the network."""

import json
from dataclasses import is_dataclass
from typing import Any

import numpy as np

from hexctl.errors import HexctlError, InputError
from hexctl.robot.model import Robot, changed_fields
from hexctl.robot.schema import Body, GaitDefaults, ServoModel

VERSION = 1

#: Fields of a robot with fields of their own.
PARTS: dict[str, Any] = {"body": Body, "servo": ServoModel, "gait": GaitDefaults}


def robot_to_json(robot: Robot) -> str:
    """JSON of a robot, from which `robot_from_json` makes an equal one."""
    return json.dumps({"version": VERSION, **robot_to_dict(robot)})


def robot_from_json(text: str) -> Robot:
    """Robot of `robot_to_json`; raises InputError for anything else."""
    try:
        values = json.loads(text)
        if values.pop("version") != VERSION:
            raise ValueError("another version")
        return robot_from_dict(values)
    except (HexctlError, ValueError, KeyError, AttributeError, TypeError) as error:
        raise InputError(f"robot description: {error}; allowed: JSON of this version of hexctl") from error


def robot_to_dict(robot: Robot) -> dict[str, Any]:
    """Fields of a robot without the default ones, as JSON values."""
    return {name: _plain(value) for name, value in changed_fields(robot)}


def robot_from_dict(values: dict[str, Any]) -> Robot:
    """Robot of `robot_to_dict`; raises ValueError or TypeError for anything else."""
    made = {name: _array(value) for name, value in values.items()}
    return Robot(**made | {name: part(**values[name]) for name, part in PARTS.items() if name in values})


def _plain(value: object) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if is_dataclass(value) and not isinstance(value, type):
        return {name: _plain(part) for name, part in changed_fields(value)}
    return list(value) if isinstance(value, tuple) else value


def _array(value: Any) -> Any:
    is_array = isinstance(value, list) and not all(isinstance(part, str) for part in value)
    return np.array(value, dtype=float) if is_array else value
