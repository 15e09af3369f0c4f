"""Self-description of a robot: its model, compared with the expected one, and who started it."""

import json
import os
import pwd
import re
import socket
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from hexctl.errors import InputError, MessageError, RobotFaultError, argument, printable_parts, shown
from hexctl.robot.formats.json_model import robot_from_dict, robot_to_dict
from hexctl.robot.model import Robot
from hexctl.types import JOINT_NAMES
from hexctl.wire import MAX_PAYLOAD_BYTES, PROTOCOL_VERSION
from hexctl.wire.links import Link

#: Valid name of a robot on the network: one part of a key.
ROBOT_NAME = re.compile(r"[\w.-]{1,60}")

#: Tolerance for numbers of two descriptions.
SAME = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotIdentity:
    """Which robot answers on a link, and who started its server; unreported fields are `?` or None.

    It protects against mistakes on a shared computer. Against forged answers, use certificates.
    """

    robot: str
    backend: str
    host: str
    user: str
    pid: int | None

    @classmethod
    def of_this_process(cls, robot: str, backend: str) -> "RobotIdentity":
        """Identity of a robot that this process serves."""
        return cls(robot=robot, backend=backend, host=socket.gethostname(), user=user_name(), pid=os.getpid())

    @classmethod
    def of_answer(cls, answer: Mapping[str, Any]) -> "RobotIdentity":
        """Identity in a robot's status or answer to a stop; a text of a wrong type is `?`."""

        def text(key: str) -> str:
            value = answer.get(key)
            return value if isinstance(value, str) and value and value.isprintable() else "?"

        pid = answer.get("pid")
        return cls(
            robot=text("robot"),
            backend=text("backend"),
            host=text("host"),
            user=text("user"),
            pid=pid if isinstance(pid, int) else None,
        )

    @property
    def is_ours(self) -> bool:
        """Whether this user started it on this computer."""
        return (self.host, self.user) == (socket.gethostname(), user_name())

    @property
    def started_by(self) -> str:
        """User, computer and process, such as `alice on lab-pc, process 4711`."""
        process = "" if self.pid is None else f", process {self.pid}"
        return f"{self.user} on {self.host}{process}"

    def __str__(self) -> str:
        """Robot, backend and who started it."""
        return f"{self.robot} ({self.backend}), started by {self.started_by}"


def user_name() -> str:
    """Owner of this process; the number if the system has no name for it, as in some containers."""
    try:
        return pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:
        return str(os.geteuid())


def check_may_command(identity: RobotIdentity, link: Link) -> None:
    """Raise InputError for another user's robot on the default link, with the way to name it."""
    if link.named or identity.is_ours:
        return
    raise InputError(
        f"the robot that answers at {link.endpoint} is {identity}, not by {user_name()} on "
        f"{socket.gethostname()}; if it is the one you mean, name it: {argument('connect')} {link.endpoint}"
    )


def describe(robot: Robot) -> dict[str, Any]:
    """Everything that robot and controller must agree on, as JSON values."""
    return {
        "protocol": PROTOCOL_VERSION,
        "joints": list(JOINT_NAMES),
        "robot": robot_to_dict(robot),
    }


def encode_json(content: dict[str, Any]) -> bytes:
    """JSON as bytes."""
    return json.dumps(content, allow_nan=False).encode()


def decode_json(payload: bytes) -> dict[str, Any]:
    """Decode a JSON object; raises MessageError for anything else."""
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise MessageError(f"JSON: got {len(payload)} bytes; allowed: {MAX_PAYLOAD_BYTES} at most")
    try:
        content = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise MessageError(f"JSON: got {payload[:40]!r}; allowed: one JSON object") from error
    if not isinstance(content, dict):
        raise MessageError(f"JSON: got {type(content).__name__}; allowed: one JSON object")
    return content


def decode_answer(payload: bytes) -> dict[str, Any]:
    """Decode a robot's JSON object and escape unprintable text; raises MessageError for anything else."""
    try:
        return dict(printable_parts(decode_json(payload)))
    except RecursionError as error:
        raise MessageError(f"JSON: got {payload[:40]!r}; allowed: one JSON object") from error


def status_of(answer: Mapping[str, Any]) -> dict[str, Any]:
    """Status in a robot's answer to a query, empty if it has none."""
    status = answer.get("status")
    return status if isinstance(status, dict) else {}


def robot_name(content: Mapping[str, Any], key: str = "robot") -> str:
    """Name of the robot in its status or description; raises RobotFaultError for an invalid one."""
    name = content.get(key)
    if not isinstance(name, str) or ROBOT_NAME.fullmatch(name) is None:
        raise RobotFaultError(
            f"the robot at the other end calls itself {shown(name)}; allowed: up to 60 letters, digits, _ . -"
        )
    return name


def check_same_robot(answer: dict[str, Any], robot: Robot) -> None:
    """Raise RobotFaultError that lists differences between the remote robot and the expected one."""
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
            f"give both ends the same {argument('robot')} file"
        )


def robot_of(answer: dict[str, Any]) -> Robot:
    """Robot that an answer describes; raises RobotFaultError for another protocol or an invalid one."""
    content = answer.get("robot")
    if answer.get("protocol") != PROTOCOL_VERSION or not isinstance(content, dict):
        raise RobotFaultError("the robot at the other end describes itself in another way; update hexctl")
    robot_name(content, "name")
    try:
        return robot_from_dict(content)
    except (TypeError, ValueError) as error:
        raise RobotFaultError(f"the robot at the other end describes itself badly: {error}") from error


def _differences(there: Any, here: Any, place: str) -> Iterator[str]:
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
