"""Prompts for the operator beside the robot: on stderr, with answers in lines on stdin."""

import os
import select
import stat
import sys

import typer

from hexctl.adapt.measurement import Answer
from hexctl.adapt.session import SessionSpec
from hexctl.cli.console import print_note
from hexctl.control.trial import StopRequested
from hexctl.errors import InputError

#: Interval at which a wait for a line checks for a stop.
LOOK_S = 0.1

WORDS = ("fell", "skip", "again", "quit")
HELP = 'two numbers in metres such as "4.1 -0.12", or fell, skip, again, quit'


def check_answerable() -> None:
    """Raise InputError where no answer can come: stdin is closed or /dev/null."""
    try:
        mode = os.fstat(sys.stdin.fileno()).st_mode
    except (AttributeError, OSError, ValueError):
        mode = stat.S_IFCHR
    if stat.S_ISCHR(mode) and not (sys.stdin and sys.stdin.isatty()):
        raise InputError("--ask: no answer can come on stdin; allowed: a terminal, or lines from a pipe")


class Prompt:
    """An operator at a terminal or a pipe; once a stop is requested the answer is quit."""

    def __init__(self, spec: SessionSpec, stop_requested: StopRequested) -> None:
        self._spec, self._stop_requested = spec, stop_requested
        self._lines = _Lines(stop_requested)

    def place(self, index: int, code: int) -> bool:
        """Ask to place the robot on its mark; return False to end instead."""
        spec = self._spec
        facing = {
            "rear": f"leg {spec.failed_leg} pointing back along the line",
            "front": f"leg {spec.failed_leg} pointing ahead along the line",
            "none": _front(spec.heading_deg),
        }
        question = (
            f"trial {index}, gait {code}: put the robot on the mark with {facing[spec.self_rotation]}; "
            "Enter walks, quit ends: "
        )
        while (said := self._ask(question)) != "":
            if said == "quit":
                return False
            question = f"got {said!r}; allowed: Enter to walk, quit: "
        return True

    def measure(self, index: int, *, at_most_m: float) -> Answer:
        """Ask for the outcome of a trial until the answer is understood."""
        question = f"trial {index}: metres along the line and metres to its left (right: -): "
        while True:
            said = self._ask(question)
            if said in WORDS:
                return Answer(word=said)  # type: ignore[arg-type]  # a word of WORDS
            try:
                distance_m, signed_m = (float(number) for number in said.replace(",", " ").split())
            except ValueError:
                question = f"got {said!r}; allowed: {HELP}: "
                continue
            if all(abs(number) <= at_most_m for number in (distance_m, signed_m)):
                return Answer(word="measured", distance_m=distance_m, signed_m=signed_m)
            question = f"got {said!r}; allowed: up to {at_most_m:.1f} m, in metres: "

    def _ask(self, question: str) -> str:
        typer.echo(question, err=True, nl=False)
        line = self._lines.next_line()
        if line is None:
            print_note("" if self._stop_requested() else "\nhexctl: stdin has ended: quit")
            return "quit"
        return " ".join(line.lower().split())


def _front(heading_deg: float) -> str:
    """Placement of a body that will travel in a direction in its own frame."""
    if heading_deg == 0:
        return "its front along the line"
    side = "right" if heading_deg > 0 else "left"
    return f"its front {abs(heading_deg):g} degrees to the {side} of the line"


class _Lines:
    """Lines of stdin; Ctrl-C ends the wait for one."""

    def __init__(self, stop_requested: StopRequested) -> None:
        self._stop_requested = stop_requested
        self._pending = b""
        self._ended = False

    def next_line(self) -> str | None:
        """Next line, None at the end of stdin or when a stop is requested."""
        while b"\n" not in self._pending and not self._ended:
            if self._stop_requested():
                return None
            if select.select([sys.stdin], [], [], LOOK_S)[0]:
                more = os.read(sys.stdin.fileno(), 4096)
                self._pending, self._ended = self._pending + more, not more
        if not self._pending:
            return None
        line, _, self._pending = self._pending.partition(b"\n")
        return line.decode(errors="replace")
