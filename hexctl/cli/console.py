"""The terminal: results on stdout, notes and progress on stderr, Ctrl-C, exit codes, where results go."""

import io
import os
import signal
import sys
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any, Self

import typer

from hexctl.errors import HexctlError, RobotFaultError, printable
from hexctl.options import flag_name
from hexctl.signals import ending_signals

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rich.console import RenderableType
    from rich.progress import Progress

    from hexctl.control.trial_result import TrialResult

# Exit codes of every command.
DONE = 0
BAD_INPUT = 2
FAULT = 3
ABORTED = 4
INTERRUPTED = 130

#: Reasons of a stop that are a fault of the robot or its link; `fault` may have details after a colon.
FAULTS = ("fault", "state", "pose lost", "expired")

#: Signals of which a second one asks to quit without a soft stop.
QUITS = (signal.SIGINT, signal.SIGTERM, signal.SIGQUIT)

#: Columns of output that goes to a file or a pipe: no line of a table is wrapped there.
PIPE_COLUMNS = 400


def code_of_stop(reason: str) -> int:
    """Exit code of what was stopped for a reason: a fault, or anything else."""
    return FAULT if reason.partition(":")[0] in FAULTS else ABORTED


def code_of(result: "TrialResult") -> int:
    """Exit code of a trial that was not interrupted."""
    if result.status == "diverged" or code_of_stop(result.stopped or "") == FAULT:
        return FAULT
    return ABORTED if result.status in ("fell", "aborted") else DONE


def never_commanded(outcome: "Mapping[str, Any]") -> bool:
    """Whether a walk or a diagnosis was interrupted before the robot was told anything."""
    return outcome["stopped"] == "requested" and not outcome["ticks"]


def note_never_commanded() -> None:
    """Say that a command was interrupted before the robot was told anything."""
    print_note("hexctl: interrupted before the robot was commanded")


def printable_lines(text: str) -> str:
    """Text of lines in which what is unprintable is escaped."""
    return "\n".join(map(printable, text.split("\n")))


def print_result(*parts: "RenderableType") -> None:
    """Print on stdout: texts as they are, tables as wide as the terminal.

    A reader that has closed the pipe, as `head` does, is not an error. Raises RobotFaultError when the result
    cannot be written, as on a full disk.
    """
    text = "\n".join(printable_lines(part) if isinstance(part, str) else _rendered(part) for part in parts)
    try:
        typer.echo(text)
        sys.stdout.flush()
    except BrokenPipeError:
        _discard_stdout()
    except OSError as error:
        _discard_stdout()
        raise RobotFaultError(f"the result cannot be printed: {error.strerror}") from error


def _rendered(part: "RenderableType") -> str:
    from rich.console import Console

    terminal = sys.stdout.isatty()
    written = io.StringIO()
    width = None if terminal else PIPE_COLUMNS
    console = Console(file=written, force_terminal=terminal, width=width, markup=False, emoji=False)
    console.print(part)
    return "\n".join(line.rstrip() for line in written.getvalue().splitlines())


def _discard_stdout() -> None:
    """Point stdout to nowhere, so that Python does not report the closed pipe again when it exits."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


#: Flags of the options of the command that was loaded, by the name of their fields. A session is an argument.
FLAGS = {"session": "session"}


def flag_of(argument: str) -> str:
    """Flag that gives an argument of the library on the command line: `--target` for `target_m`."""
    return FLAGS.get(argument, f"--{flag_name(argument)}")


def in_flags(error: HexctlError) -> str:
    """Text of an error with the command line's flags in place of the library's arguments."""
    return error.worded(flag_of)


def print_note(text: str) -> None:
    """Print a line on stderr."""
    typer.echo(printable_lines(text), err=True)


def print_question(text: str) -> None:
    """Print a question on stderr and stay on its line."""
    typer.echo(printable_lines(text), err=True, nl=False)


class StatusLine:
    """A line on stderr that each new text replaces on a terminal; elsewhere each text is a line."""

    def __init__(self) -> None:
        self._shown = False

    def show(self, text: str) -> None:
        """Show a text in place of the last one, cut to the width of the terminal."""
        if not sys.stderr.isatty():
            print_note(text)
            return
        width = os.get_terminal_size(sys.stderr.fileno()).columns or 80
        typer.echo(f"\r\x1b[K{printable(text)[: width - 1]}", err=True, nl=False)
        self._shown = True

    def print_above(self, text: str) -> None:
        """Print a line that stays; the next text is shown below it."""
        self.end()
        print_note(text)

    def end(self) -> None:
        """End the line that is shown; it stays."""
        if self._shown:
            print_note("")
        self._shown = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.end()


def note_no_window(error: Exception) -> None:
    """Say why a walk is not shown."""
    print_note(f"hexctl: {error}; continuing without a window")


def note_refusal(why: str, *, then: str = "") -> None:
    """Say that nothing listens where a robot should be, while it is still tried; `then` is said behind."""
    print_note(f"hexctl: {why}; trying for some seconds more{then}")


def make_bar(counter: str | None = None, *, quiet: bool = False) -> "Progress":
    """Progress bar on stderr with the time left, not yet started; it disappears when it stops.

    Args:
        counter: format of the progress; None counts whole things, done of all.
        quiet: True for a bar that shows nothing, as where stderr is not a terminal.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn() if counter is None else TextColumn(counter),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
        disable=quiet or not sys.stderr.isatty(),
    )


def print_above(bar: "Progress", text: str, *, err: bool) -> None:
    """Print a line above a bar; where the bar shows nothing, on stderr or stdout."""
    if bar.disable:
        typer.echo(printable_lines(text), err=err)
    else:
        bar.console.print(printable_lines(text), highlight=False, markup=False, emoji=False)


class StopOnInterrupt:
    """While open, signals that end a process only set `requested`; two of `QUITS` raise KeyboardInterrupt.

    The others never raise: SIGXCPU comes every second, and SIGHUP may come from the kernel and from a shell.
    SIGHUP says that the terminal is closed; what is printed from then on goes nowhere.

    Args:
        plain: whether there is no soft stop that a second one would leave out.

    Attributes:
        terminal_gone: whether SIGHUP has come.
    """

    def __init__(self, *, plain: bool = False) -> None:
        self._requested = self._interrupted = self.terminal_gone = False
        self._terminals: list[int] = []
        self._again = "quit at once" if plain else "quit without a soft stop"
        self._before: dict[int, Any] = {}

    def requested(self) -> bool:
        """Whether a stop was requested."""
        return self._requested

    def __enter__(self) -> Self:
        self._terminals = [stream for stream in (1, 2) if os.isatty(stream)]
        for number in ending_signals():
            self._before[number] = signal.signal(number, self._handle)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

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
        """Point what was printed on a terminal that has gone to nowhere: writing there is an error."""
        for stream in self._terminals:
            if not os.isatty(stream):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
