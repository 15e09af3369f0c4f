"""Progress and interruption of long work, such as studies, priors and scans of a bus."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Self

import typer

from hexctl.cli.console import INTERRUPTED, QUITS, make_bar, print_above, print_note
from hexctl.errors import printable
from hexctl.signals import handled_by

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from hexctl.study.plan import PlannedWork, ResultT


#: How long a question to an id without a servo takes.
ANSWER_S = 0.03


class WithBar:
    """Shows a progress bar while a block runs."""

    _bar: "Progress"

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()


class StatusLine(WithBar):
    """Status on stderr: on a terminal one line that is replaced, and stays at the end; else a line each."""

    def __init__(self) -> None:
        self._bar = make_bar(text_only=True)
        self._task = self._bar.add_task("", total=None, visible=False)

    def show(self, text: str) -> None:
        """Replace the text."""
        if self._bar.disable:
            print_note(text)
        self._bar.update(self._task, description=printable(text), visible=True)

    def print_above(self, text: str) -> None:
        """Print a permanent line above it."""
        print_above(self._bar, text, err=True)


class ScanProgress(WithBar):
    """Progress of a scan on stderr: a bar on a terminal, else one line."""

    def __init__(self, text: str = "asking ids") -> None:
        self._bar, self._text = make_bar(), text
        self._task: TaskID | None = None

    def show(self, asked: int, of: int) -> None:
        """Show the number of queried ids."""
        if self._task is None:
            self._task = self._bar.add_task(self._text, total=of)
            if self._bar.disable:
                print_note(f"{self._text}: {of}, up to {of * ANSWER_S:.0f} s")
        self._bar.update(self._task, completed=asked)


class StudyProgress(WithBar):
    """Progress on stderr: a bar on a terminal, else a line per finished set of walks; `notes` come first."""

    def __init__(self, notes: Iterable[str] = ()) -> None:
        self._notes = iter(notes)
        self._bar = make_bar()
        self._task = self._bar.add_task("", total=None, visible=False)

    def stage(self, what: str, total: int) -> None:
        """Begin a part of the work."""
        self._first_notes()
        self._bar.remove_task(self._task)
        self._task = self._bar.add_task(what, total=total)

    def step(self, steps: int = 1) -> None:
        """Count steps of the current part."""
        self._bar.update(self._task, advance=steps)

    def note(self, text: str) -> None:
        """Print a line above the bar."""
        self._first_notes()
        self._line(text)

    def _first_notes(self) -> None:
        for note in self._notes:
            self._line(note)

    def _line(self, text: str) -> None:
        print_above(self._bar, text, err=True)


@contextmanager
def interruptible() -> Iterator[None]:
    """Let all signals that end a process raise KeyboardInterrupt: once, except for those that quit."""
    interrupted = False

    def interrupt(number: int, _frame: FrameType | None) -> None:
        nonlocal interrupted
        first, interrupted = not interrupted, True
        if first or number in QUITS:  # SIGXCPU comes every second, and SIGHUP twice
            raise KeyboardInterrupt

    with handled_by(interrupt):
        yield


def finish(planned: "PlannedWork[ResultT]", notes: Iterable[str] = ()) -> "ResultT":
    """Run planned work with its progress on stderr, after `notes`.

    All signals that end a process end it with exit code 130 and a line on the saved walks.
    """
    try:
        with interruptible(), StudyProgress(notes) as progress:
            return planned.run(progress=progress)
    except KeyboardInterrupt:
        from hexctl.study.walk_cache import WalkCache

        cache = WalkCache()
        saved, total = planned.saved(cache)
        kept = f"{saved} of {total} walks are saved in {cache.folder}"
        print_note(f"interrupted: {kept}; the same command continues")
        raise typer.Exit(INTERRUPTED) from None
