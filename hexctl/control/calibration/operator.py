"""The operator of a calibration: questions, answers and saved files."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from hexctl.errors import InputError
from hexctl.robot.loader import load_robot_file
from hexctl.robot.servos.raw_map import LIMIT_KEYS, RawMap
from hexctl.robot.servos.servos_section import back_up, write_joint
from hexctl.types import JOINT_NAMES

#: Positive and negative movements of each kind of joint, as seen.
SEEN = {
    "coxa": ("counter-clockwise seen from above", "clockwise seen from above"),
    "femur": ("up, with the whole leg", "down, with the whole leg"),
    "tibia": ("up and outward", "down and inward"),
}

INTRODUCTION = "skip leaves a step as it is, quit ends; every joint is saved when it is done."


class EndedError(Exception):
    """The operator ends the calibration."""


class Operator(Protocol):
    """The person who watches the robot, as the application reaches them; no method may block."""

    def tell(self, text: str) -> None:
        """Show a line."""
        ...

    def prompt(self, text: str) -> None:
        """Show a question; its answer is polled for."""
        ...

    def poll(self) -> str | None:
        """The answer to the last question, or None if there is none yet; raises EndedError after the last."""
        ...


@dataclass(slots=True)
class CalibrationResult:
    """The changes of a calibration; the backup is None if nothing was saved."""

    path: Path
    saved: list[str] = field(default_factory=list)
    backup: Path | None = None

    def has(self, joint: int) -> bool:
        """Whether the file has sign, offset and limits of a joint, 0..17, itself."""
        own = load_robot_file(self.path).content.servos
        values = getattr(own, JOINT_NAMES[joint])
        keys = ("sign", "offset_deg")
        return all(getattr(values, key) is not None for key in keys) and any(
            all(getattr(values, key) is not None for key in pair) for pair in LIMIT_KEYS.values()
        )

    def save(self, joint: int, servo_map: RawMap) -> None:
        """Write the map of one joint, 0..17; the keys of the others stay as they are."""
        if self.backup is None:
            self.backup = back_up(self.path)
        write_joint(self.path, servo_map, joint)
        self.saved.append(JOINT_NAMES[joint])


def ask(operator: Operator, question: str, tick: Callable[[], object]) -> str:
    """The operator's answer, in lower case; `tick` runs until it comes. Raises EndedError for `quit`."""
    operator.prompt(question)
    while (answer := operator.poll()) is None:
        tick()
    if answer.lower() in ("quit", "q"):
        raise EndedError
    return answer.lower()


def done(operator: Operator, change: Callable[..., object], *values: Any) -> bool:
    """Whether a change of the calibration succeeds; the operator is shown why it does not."""
    try:
        change(*values)
    except InputError as error:
        operator.tell(f"  {error}")
        return False
    return True


def measured_deg(answer: str) -> float | None:
    """The angle of an answer such as `at 12.5`, or None for any other answer."""
    if not answer.startswith("at "):
        return None
    try:
        value = float(answer[3:])
    except ValueError:
        return None
    return value if math.isfinite(value) else None
