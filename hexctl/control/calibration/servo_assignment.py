"""Servo assignment: a servo on the bus is wiggled, and the operator names the joint that moved."""

import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from hexctl.backends.bus.family import find_family
from hexctl.backends.bus.servo import ScannedServo
from hexctl.backends.bus.tools import opened_line, the_servo
from hexctl.control.calibration.operator import EndedError, Operator, ask
from hexctl.control.calibration.servo_trial import WIGGLE_DEG, wiggle
from hexctl.errors import InputError, RobotFaultError, argument
from hexctl.files import atomic_write, check_new, write_new
from hexctl.robot.servos.servo_schema import ServosSection
from hexctl.types import JOINT_KINDS, JOINT_NAMES, N_LEGS

#: Interval between polls for an answer.
LOOK_S = 0.05

#: Shown before the first servo moves.
INTRODUCTION = (
    "Hold the robot up so that its legs hang free. A servo that is tried goes limp first, and moves by "
    f"{WIGGLE_DEG:g} degrees and back."
)

_JOINT = re.compile(r"(?:leg)?([1-6])[ _:]?(coxa|femur|tibia|c|f|t)")


@dataclass(slots=True)
class ServoAssignment:
    """Servos whose joints are known; `model` is of servos that do not report it.

    Attributes:
        output: file for the section `servos`, or None; a draft next to it keeps the results so far.
    """

    driver: str
    port: str
    baud: int
    output: Path | None = None
    ids: dict[str, int] = field(default_factory=dict)
    models: dict[str, str | None] = field(default_factory=dict)
    model: str | None = None

    @property
    def draft(self) -> Path | None:
        """File with the results so far, until it is complete."""
        return None if self.output is None else self.output.with_name(f"{self.output.name}.part")

    @property
    def complete(self) -> bool:
        """Whether every joint has its servo."""
        return len(self.ids) == len(JOINT_NAMES)

    def section(self) -> str:
        """The known part of section `servos` of a robot file, as YAML."""
        models = set(filter(None, self.models.values()))
        lines = [f"driver: {self.driver}", f"port: {self.port}", f"baud: {self.baud}"]
        lines += [f"model: {models.pop()}"] if len(models) == 1 else []
        for name in JOINT_NAMES:
            if name in self.ids:
                own = f", model: {self.models[name]}" if len(models) > 1 and self.models.get(name) else ""
                lines.append(f"{name}: {{id: {self.ids[name]}{own}}}")
        return "servos:\n" + "".join(f"  {line}\n" for line in lines)

    def resume(self) -> None:
        """Continue from a draft; raises InputError for an existing output and a draft of another bus."""
        if self.output is None or self.draft is None:
            return
        check_new(self.output, argument("output"))
        if not self.output.parent.is_dir():
            raise InputError(
                f"{argument('output')}: got {self.output}; allowed: a file in an existing folder"
            )
        if self.draft.is_file():
            self._take_over(self.draft)

    def know(self, joint: str, servo: ScannedServo) -> None:
        """Record the servo that moves a joint, and save the draft."""
        self.ids[joint], self.models[joint] = servo.servo_id, servo.model or self.model
        if self.draft is not None:
            atomic_write(self.draft, self.section())

    def finish(self) -> bool:
        """Write the output once every joint is known; whether it was written."""
        if self.output is None or self.draft is None or not self.complete:
            return False
        write_new(self.output, self.section(), argument("output"))
        self.draft.unlink(missing_ok=True)
        return True

    def _take_over(self, draft: Path) -> None:
        try:
            section = ServosSection.model_validate(yaml.safe_load(draft.read_text())["servos"])
        except (yaml.YAMLError, ValueError, KeyError, TypeError) as error:
            raise InputError(f"{draft}: got no section `servos`; delete it to begin again") from error
        if section.driver != self.driver:
            raise InputError(f"{draft}: got driver {section.driver}; allowed: {self.driver}")
        for name in JOINT_NAMES:
            joint = getattr(section, name)
            if joint.id is not None:
                self.ids[name], self.models[name] = joint.id, joint.model or section.model


def joint_named(text: str) -> str | None:
    """Joint of an answer such as `leg3_femur`, `3 femur` or `3f`; None for anything else."""
    found = _JOINT.fullmatch(text.strip().lower())
    if found is None:
        return None
    kind = next(each for each in JOINT_KINDS if each.startswith(found[2][0]))
    return f"leg{found[1]}_{kind}"


def assign_servos(
    known: ServoAssignment,
    ids: Sequence[int],
    operator: Operator,
    *,
    consent: bool = False,
    stop_requested: Callable[[], bool] = lambda: False,
) -> None:
    """Wiggle the servos with some ids one after the other, and ask which joint each moves.

    Known servos, and those that cannot be moved, are left out; with `consent` they move without asking. A
    stop ends a movement immediately.
    Raises RobotFaultError for a port that cannot be opened, or is lost.
    """
    left = [servo_id for servo_id in ids if servo_id not in known.ids.values()]
    operator.tell(INTRODUCTION)
    with opened_line(known.port, known.baud, find_family(known.driver)) as line:
        for place, servo_id in enumerate(left, start=1):
            try:
                servo = the_servo(line, known.driver, servo_id)
                found = servo.look()
                what = (
                    f"id {servo_id} ({found.model or known.model or 'unknown model'}), {place} of {len(left)}"
                )
                if not consent and not _may_move(operator, what, stop_requested):
                    continue
                joint = None
                while joint is None:
                    wiggle(servo, stop_requested=stop_requested)
                    joint = _joint(known, operator, what, stop_requested)
                if joint:
                    known.know(joint, found)
            except EndedError:
                return
            except RobotFaultError as error:
                operator.tell(f"id {servo_id}: {error}; it is left out")


def _may_move(operator: Operator, what: str, stop_requested: Callable[[], bool]) -> bool:
    question = f"{what}: Enter moves it, skip, quit:"
    while True:
        said = operator_answer(operator, question, stop_requested)
        if said in ("", "y", "yes", "enter"):
            return True
        if said in ("s", "skip"):
            operator.tell(f"{what}: skipped")
            return False
        question = f"got {said!r}; allowed: Enter or yes, which moves {what}; skip, quit:"


def _joint(
    known: ServoAssignment, operator: Operator, what: str, stop_requested: Callable[[], bool]
) -> str | None:
    """Joint that moved; None to see it again, empty for a servo of no joint."""
    question = f"{what}: which joint moved? leg3_femur or 3f, again, none, quit:"
    while True:
        said = operator_answer(operator, question, stop_requested)
        if said == "again":
            return None
        if said == "none":
            return ""
        joint = joint_named(said)
        if joint is None:
            names = f"leg1 to leg{N_LEGS} with {', '.join(JOINT_KINDS)}, such as leg3_femur"
            question = f"got {said!r}; allowed: {names}; again, none, quit:"
        elif joint in known.ids:
            question = f"{joint} has id {known.ids[joint]} already; which joint moved now? again, none, quit:"
        else:
            return joint


def operator_answer(operator: Operator, question: str, stop_requested: Callable[[], bool]) -> str:
    """Answer to a question; raises EndedError for `quit`, and when a stop is requested."""

    def wait() -> None:
        if stop_requested():
            raise EndedError
        time.sleep(LOOK_S)

    return " ".join(ask(operator, question, wait).split())
