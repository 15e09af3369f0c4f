"""The terminal: output, the progress bar, Ctrl-C, exit codes, and the folder of results."""

import os
import signal
import sys
from pathlib import Path
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any, Self

import typer

from hexctl.errors import RobotFaultError

if TYPE_CHECKING:
    from hexctl.control.result import TrialResult


def print_result(text: str) -> None:
    """Print text on stdout."""
    try:
        typer.echo(text)
        sys.stdout.flush()
    except BrokenPipeError:
        # Python must not complain about the closed pipe again while it exits.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise RobotFaultError(f"the result cannot be printed: {error.strerror}") from error


def print_note(text: str) -> None:
    """Print a line on stderr, for a person who watches."""
    typer.echo(text, err=True)


DONE = 0
BAD_INPUT = 2
FAULT = 3
ABORTED = 4
INTERRUPTED = 130

#: Stops that are the robot's or the link's fault rather than somebody's wish or a fall; `fault` may say more
#: after a colon.
FAULTS = ("fault", "state", "pose lost", "expired")


def code_of(result: "TrialResult") -> int:
    """Return the exit code of a trial that nobody interrupted."""
    if result.status == "diverged" or (result.stopped or "").partition(":")[0] in FAULTS:
        return FAULT
    return ABORTED if result.status in ("fell", "aborted") else DONE


SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StopOnInterrupt:
    """While open, SIGINT and SIGTERM only set `requested`; a second one raises KeyboardInterrupt."""

    def __init__(self) -> None:
        self._requested = False
        self._before: dict[signal.Signals, Any] = {}

    def requested(self) -> bool:
        """Return whether a stop was asked for."""
        return self._requested

    def __enter__(self) -> Self:
        for number in SIGNALS:
            self._before[number] = signal.signal(number, self._handle)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self._requested:
            raise KeyboardInterrupt
        self._requested = True
        if sys.stderr.isatty():
            os.write(sys.stderr.fileno(), b"\nstopping softly; Ctrl-C again ends at once\n")


#: Recordings, sessions and studies.
RUNS = Path("runs")


def make_bar(counter: str | None = None) -> Any:
    """Return a rich progress bar with the time left, not yet started.

    Args:
        counter: format of how far it is; None counts whole things, done of all.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn() if counter is None else TextColumn(counter),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
    )
