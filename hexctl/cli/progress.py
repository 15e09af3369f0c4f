"""Progress and interruption of long work, such as scans of a bus."""

from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Self

from hexctl.cli.console import QUITS, make_bar, print_above, print_note
from hexctl.errors import printable
from hexctl.signals import handled_by

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID


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
