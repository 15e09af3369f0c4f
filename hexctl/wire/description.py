"""What a robot says when it is asked who it is, and where that differs from what a controller expects."""

import json
from collections.abc import Iterator
from dataclasses import asdict, fields, is_dataclass
from typing import Any

import numpy as np

from hexctl.errors import MessageError, RobotFaultError
from hexctl.robot.model import Body, GaitDefaults, Robot, ServoModel
from hexctl.types import JOINT_NAMES
from hexctl.wire import MAX_PAYLOAD_BYTES, PROTOCOL_VERSION

#: Numbers of two descriptions that differ by no more are equal.
SAME = 1e-9


def describe(robot: Robot) -> dict[str, Any]:
    """Return everything a controller must agree on, as JSON values."""
    return {
        "protocol": PROTOCOL_VERSION,
        "joints": list(JOINT_NAMES),
        "robot": {field.name: _plain(getattr(robot, field.name)) for field in fields(robot)},
    }


def encode_json(content: dict[str, Any]) -> bytes:
    """Return JSON as bytes."""
    return json.dumps(content, allow_nan=False).encode()


def decode_json(payload: bytes) -> dict[str, Any]:
    """Return the one JSON object that bytes hold.

    Raises MessageError for anything else.
    """
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise MessageError(f"JSON: got {len(payload)} bytes; allowed: {MAX_PAYLOAD_BYTES} at most")
    try:
        content = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise MessageError(f"JSON: got {payload[:40]!r}; allowed: one JSON object") from error
    if not isinstance(content, dict):
        raise MessageError(f"JSON: got {type(content).__name__}; allowed: one JSON object")
    return content


def check_same_robot(answer: dict[str, Any], robot: Robot) -> None:
    """Raise RobotFaultError that says where the robot at the other end differs from the one expected here."""
    if answer.get("protocol") != PROTOCOL_VERSION:
        raise RobotFaultError(
            f"the robot speaks protocol {answer.get('protocol')!r}, this hexctl {PROTOCOL_VERSION}; "
            "install the same version of hexctl on both ends"
        )
    there, here = answer.get("robot"), describe(robot)
    if answer.get("joints") != here["joints"] or not isinstance(there, dict):
        raise RobotFaultError("the robot names other joints than this hexctl; install the same version")
    different = list(_differences(there, here["robot"], ""))
    if different:
        more = f" and in {len(different) - 1} more places" if len(different) > 1 else ""
        raise RobotFaultError(
            f"the robot at the other end is another one: {different[0]}{more}; "
            "give both ends the same --robot file"
        )


def robot_of(answer: dict[str, Any]) -> Robot:
    """Return the robot that an answer describes.

    Raises RobotFaultError for one of another protocol, or one that is no robot.
    """
    content = answer.get("robot")
    if answer.get("protocol") != PROTOCOL_VERSION or not isinstance(content, dict):
        raise RobotFaultError("the robot at the other end describes itself in another way; update hexctl")
    parts: dict[str, Any] = {"body": Body, "servo": ServoModel, "gait": GaitDefaults}
    try:
        values: dict[str, Any] = {name: _array(value) for name, value in content.items()}
        values |= {name: part(**content[name]) for name, part in parts.items() if name in content}
        return Robot(**values)
    except (TypeError, ValueError) as error:
        raise RobotFaultError(f"the robot at the other end describes itself badly: {error}") from error


def _array(value: Any) -> Any:
    return np.array(value, dtype=float) if isinstance(value, list) else value


def _plain(value: object) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if is_dataclass(value) and not isinstance(value, type):
        return {name: _plain(part) for name, part in asdict(value).items()}
    return list(value) if isinstance(value, tuple) else value


def _differences(there: Any, here: Any, place: str) -> Iterator[str]:
    """Yield every place at which two descriptions differ, with both values."""
    if isinstance(there, dict) and isinstance(here, dict):
        for key in sorted(here.keys() | there.keys()):
            yield from _differences(there.get(key), here.get(key), f"{place}.{key}" if place else key)
    elif isinstance(there, list) and isinstance(here, list) and len(there) == len(here):
        for index, (one, other) in enumerate(zip(there, here, strict=True)):
            yield from _differences(one, other, f"{place}[{index}]")
    elif not _same(there, here):
        yield f"{place} is {there} there and {here} here"


def _same(one: Any, other: Any) -> bool:
    numbers = all(isinstance(value, int | float) for value in (one, other))
    return bool(abs(one - other) <= SAME) if numbers else bool(one == other)
