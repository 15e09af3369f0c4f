"""The terminal: results on stdout, notes and progress on stderr, Ctrl-C, exit codes."""

import io
import json
import os
import signal
import sys
from types import FrameType
from typing import TYPE_CHECKING, Any, Self

import typer

from hexctl.errors import HexctlError, RobotFaultError, printable
from hexctl.options import flag_name
from hexctl.signals import handled_by

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.progress import Progress

    from hexctl.control.trial_result import TrialResult

JsonValue = dict[str, Any] | list[Any]

# Exit codes of every command.
DONE = 0
BAD_INPUT = 2
FAULT = 3
ABORTED = 4
INTERRUPTED = 130

#: Stop reasons caused by a fault of the robot or its link; `fault` may have details after a colon.
FAULTS = ("fault", "state", "pose lost", "expired")

#: A second one of these signals quits without a soft stop.
QUITS = (signal.SIGINT, signal.SIGTERM, signal.SIGQUIT)

#: Width of output to a file or a pipe: no table line is wrapped.
PIPE_COLUMNS = 400


def code_of_stop(reason: str) -> int:
    """Exit code of a stop with a reason."""
    return FAULT if reason.partition(":")[0] in FAULTS else ABORTED


def code_of(result: "TrialResult") -> int:
    """Exit code of a complete trial."""
    if result.status == "diverged" or code_of_stop(result.stopped or "") == FAULT:
        return FAULT
    return ABORTED if result.status in ("fell", "aborted") else DONE


def printable_lines(text: str) -> str:
    """Text with unprintable characters escaped, except line ends."""
    return "\n".join(map(printable, text.split("\n")))


def print_result(*parts: "RenderableType | JsonValue") -> bool:
    """Print on stdout: texts as they are, tables as wide as the terminal, objects and arrays as JSON.

    Returns False for a closed pipe. Raises RobotFaultError when the result cannot be written, as on a full
    disk.
    """
    text = "\n".join(map(_text, parts))
    try:
        typer.echo(text)
        sys.stdout.flush()
    except BrokenPipeError:
        discard_stdout()
        return False
    except OSError as error:
        discard_stdout()
        raise RobotFaultError(f"the result cannot be printed: {error.strerror}") from error
    return True


def _text(part: "RenderableType | JsonValue") -> str:
    if isinstance(part, dict | list):
        return json.dumps(part)
    if isinstance(part, str):
        return printable_lines(part)
    from rich.console import Console

    terminal = sys.stdout.isatty()
    written = io.StringIO()
    width = None if terminal else PIPE_COLUMNS
    console = Console(file=written, force_terminal=terminal, width=width, markup=False, emoji=False)
    console.print(part, crop=False)
    return "\n".join(line.rstrip() for line in written.getvalue().splitlines())


def discard_stdout() -> None:
    """Python would report the closed pipe again at its exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


#: Flags of the loaded command's options by field. A session is an argument.
FLAGS = {"session": "session"}


def flag_of(argument: str) -> str:
    """Flag of an argument of the library: `--target` for `target_m`."""
    return FLAGS.get(argument, f"--{flag_name(argument)}")


def in_flags(error: HexctlError) -> str:
    """Text of an error with flags in place of the library's arguments."""
    return error.worded(flag_of)


def print_note(text: str) -> None:
    """Print a line on stderr."""
    typer.echo(printable_lines(text), err=True)


def print_message(text: object) -> None:
    """Print a line on stderr that begins with the name of the program."""
    print_note(f"hexctl: {text}")


def print_question(text: str) -> None:
    """Print a question on stderr without a line end."""
    typer.echo(printable_lines(text), err=True, nl=False)


def note_no_window(error: Exception) -> None:
    """Report why a walk is not shown."""
    print_message(f"{error}; continuing without a window")


def note_refusal(why: str, *, then: str = "") -> None:
    """Report that nothing listens at a robot's endpoint while connecting goes on; `then` follows."""
    print_message(f"{why}; trying for some seconds more{then}")


def make_bar(counter: str | None = None, *, quiet: bool = False, text_only: bool = False) -> "Progress":
    """Progress bar on stderr with the time left, or a text that stays, not started; `counter`: its format."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    count = MofNCompleteColumn() if counter is None else TextColumn(counter)
    return Progress(
        TextColumn("{task.description}", markup=False),
        *(() if text_only else (BarColumn(), count, TimeRemainingColumn())),
        console=Console(stderr=True),
        transient=not text_only,
        disable=quiet or not sys.stderr.isatty(),
    )


def print_above(bar: "Progress", text: str, *, err: bool) -> None:
    """Print a line above a bar; if the bar is hidden, on stderr or stdout."""
    if bar.disable:
        typer.echo(printable_lines(text), err=err)
    else:
        bar.console.print(printable_lines(text), highlight=False, markup=False, emoji=False)


class LeftOut:
    """Names the damaged parts that a command leaves out, and counts them; the command continues."""

    def __init__(self) -> None:
        self.count = 0

    def name(self, error: HexctlError) -> None:
        """Print an error; this is an `on_damage`."""
        print_message(error)
        self.count += 1

    def code(self, code: int = DONE) -> int:
        """Exit code of a command that would end with `code` if nothing had been left out."""
        return FAULT if self.count and code == DONE else code


class StopOnInterrupt:
    """Turns signals that end a process into `requested`; two of `QUITS` raise KeyboardInterrupt.

    The others never raise: SIGXCPU comes every second, and SIGHUP may come from both kernel and shell. After
    SIGHUP, a closed terminal, output is discarded.

    Args:
        plain: whether there is no soft stop that a second signal would skip.

    Attributes:
        terminal_gone: whether SIGHUP has come.
    """

    def __init__(self, *, plain: bool = False) -> None:
        self._requested = self._interrupted = self.terminal_gone = False
        self._terminals: list[int] = []
        self._again = "quit at once" if plain else "quit without a soft stop"
        self._handled = handled_by(self._handle)

    def requested(self) -> bool:
        """Whether a stop was requested."""
        return self._requested

    def __enter__(self) -> Self:
        self._terminals = [stream for stream in (1, 2) if os.isatty(stream)]
        self._handled.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._handled.__exit__(None, None, None)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if number not in QUITS:
            self._requested = True
            if number == signal.SIGHUP:
                self.terminal_gone = True
                self._leave_terminal()
            return
        if self._interrupted:
            raise KeyboardInterrupt
        self._requested = self._interrupted = True
        if sys.stderr.isatty():
            text = f"\nstopping; press Ctrl-C again to {self._again}\n"
            os.write(sys.stderr.fileno(), text.encode())

    def _leave_terminal(self) -> None:
        """Writing to a closed terminal is an error."""
        for stream in self._terminals:
            if not os.isatty(stream):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
