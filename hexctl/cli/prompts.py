"""Prompts for the operator of trials, calibrations and diagnoses: on stderr, answers on stdin."""

import math
import os
import select
import stat
import sys

from hexctl.adapt.measurement import Answer
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.sessions.walk_records import BASELINE_INDEX
from hexctl.cli.console import print_note, print_question
from hexctl.control.calibration.operator import EndedError
from hexctl.errors import InputError
from hexctl.waiting import StopRequested, never_stop

#: Interval at which a wait for a line checks for a stop.
LOOK_S = 0.1

ENDED = "\nhexctl: stdin has ended: quit"

WORDS = ("fell", "skip", "again", "quit")
HELP = (
    'two numbers in metres such as "4.1 -0.12", after those of points on the way if you have some, such as '
    '"2 0.1 4.1 -0.12"; or fell, skip, again, quit'
)


def can_answer() -> bool:
    """Whether an answer is possible: not if stdin is closed or /dev/null."""
    try:
        mode = os.fstat(sys.stdin.fileno()).st_mode
    except (AttributeError, OSError, ValueError):
        return False
    return not stat.S_ISCHR(mode) or bool(sys.stdin and sys.stdin.isatty())


def check_answerable(what: str = "--ask") -> None:
    """Raise InputError if no answer is possible; `what` needs one."""
    if not can_answer():
        raise InputError(f"{what}: no answer can come on stdin; allowed: a terminal, or lines from a pipe")


def ask_consent(text: str, *, yes: bool) -> None:
    """Ask whether a servo may move, unless `yes`; raises InputError without consent."""
    if yes:
        return
    if not can_answer():
        raise InputError("--yes: got none, and no answer can come on stdin; allowed: --yes, or a terminal")
    said = StdinLines().ask(f"{text} Hold the robot so that its legs hang free. Go on? yes or no: ")
    if said is None or not sys.stdin.isatty():
        print_note("")  # no key ended the line on the screen
    if said is None or said.strip().lower() not in ("y", "yes"):
        raise InputError(f"consent: got {said or 'no answer'}; allowed: yes; nothing was moved")


class TrialPrompt:
    """The operator of manually measured trials; a requested stop answers with quit."""

    def __init__(self, spec: SessionSpec, stop_requested: StopRequested) -> None:
        self._spec, self._stop_requested = spec, stop_requested
        self._lines = StdinLines()

    def place(self, index: int, code: int) -> bool:
        """Ask to place the robot on its mark; return False to end instead."""
        spec = self._spec
        facing = {
            "rear": f"leg {spec.broken.leg} pointing back along the line",
            "front": f"leg {spec.broken.leg} pointing ahead along the line",
            "none": _front(math.degrees(spec.heading_rad)),
        }
        question = (
            f"{_walk_name(index, f', gait {code}')}: put the robot on the mark with "
            f"{facing[spec.self_rotation]}; Enter walks, quit ends: "
        )
        while (said := self._ask(question)) != "":
            if said == "quit":
                return False
            question = f"got {said!r}; allowed: Enter to walk, quit: "
        return True

    def measure(self, index: int, *, at_most_m: float) -> Answer:
        """Ask for the outcome of a trial until the answer is understood."""
        question = (
            f"{_walk_name(index)}: metres along the line and metres to its left (right: -), the end last: "
        )
        while True:
            said = self._ask(question)
            if said in WORDS:
                return Answer(word=said)  # type: ignore[arg-type]  # a word of WORDS
            try:
                numbers = [float(number) for number in said.replace(",", " ").split()]
                *before_m, (distance_m, signed_m) = zip(numbers[::2], numbers[1::2], strict=True)
            except ValueError:
                question = f"got {said!r}; allowed: {HELP}: "
                continue
            if all(abs(number) <= at_most_m for number in numbers):
                return Answer(
                    word="measured", distance_m=distance_m, signed_m=signed_m, before_m=tuple(before_m)
                )
            question = f"got {said!r}; allowed: up to {at_most_m:.1f} m, in metres: "

    def _ask(self, question: str) -> str:
        line = self._lines.ask(question, self._stop_requested)
        if line is None:
            print_note("" if self._stop_requested() else ENDED)
            return "quit"
        return " ".join(line.lower().split())


def _walk_name(index: int, gait: str = "") -> str:
    return "the baseline" if index == BASELINE_INDEX else f"trial {index}{gait}"


def _front(heading_deg: float) -> str:
    if heading_deg == 0:
        return "its front along the line"
    side = "right" if heading_deg > 0 else "left"
    return f"its front {abs(heading_deg):g} degrees to the {side} of the line"


class CalibrationPrompt:
    """The operator of a calibration: questions on stderr, answers in lines, never blocking."""

    def __init__(self) -> None:
        self._lines = StdinLines()

    def tell(self, text: str) -> None:
        """Print a line."""
        print_note(text)

    def prompt(self, text: str) -> None:
        """Print a question and stay on its line."""
        print_question(f"{text} ")

    def poll(self) -> str | None:
        """The next complete line without its end, or None; raises EndedError after the end of the input."""
        line = self._lines.poll()
        if line is None and not self._lines.ended:
            return None
        if line is None or not sys.stdin.isatty():
            print_note("")  # no key ended the line on the screen
        if line is None:
            raise EndedError
        return line.strip()


class StdinLines:
    """Lines of stdin with a bounded wait; `ended` is True after the last one was taken."""

    def __init__(self) -> None:
        self.ended = False
        self._pending = b""

    def ask(self, question: str, stop_requested: StopRequested = never_stop) -> str | None:
        """Print a question and wait for its answer; None after the last line or a requested stop."""
        print_question(question)
        while (line := self.poll(LOOK_S)) is None:
            if self.ended or stop_requested():
                return None
        return line

    def poll(self, wait_s: float = 0.0) -> str | None:
        """The next line without its end, or None after the wait."""
        while b"\n" not in self._pending:
            if self.ended or not select.select([sys.stdin], [], [], wait_s)[0]:
                return None
            more = os.read(sys.stdin.fileno(), 4096)
            if not more:
                self.ended = not self._pending
                more = b"\n" if self._pending else b""  # the last line may lack its end
            self._pending += more
        line, _, self._pending = self._pending.partition(b"\n")
        return line.decode(errors="replace")


class LegPrompt:
    """The operator of a diagnosis without measurements, who reports which legs move properly."""

    def __init__(self) -> None:
        self._lines = StdinLines()

    def moved(self, leg: int) -> bool | None:
        """Ask whether a leg lifted, swung and stood again; None ends the questions."""
        question = f"leg {leg} should have lifted, swung and stood again: did it? yes, no or quit: "
        while True:
            line = self._lines.ask(question)
            if line is None:
                print_note(ENDED)
                return None
            said = line.strip().lower()
            if said in ("y", "yes", "n", "no"):
                return said.startswith("y")
            if said in ("q", "quit"):
                return None
            question = f"got {said!r}; allowed: yes, no, quit: "
