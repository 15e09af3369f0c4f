"""Progress of what takes long, such as studies, priors and scans of a bus, and its interruption."""

import signal
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Self

import typer

from hexctl.cli.console import INTERRUPTED, QUITS, make_bar, print_above, print_note
from hexctl.signals import ending_signals

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from hexctl.study.landscapes.cache import LandscapeCache
    from hexctl.study.landscapes.landscape import Landscape
    from hexctl.study.planned_work import PlannedWork, ResultT


@contextmanager
def interruptible(
    count: "Callable[[LandscapeCache], tuple[int, int]]", what: str = "gaits"
) -> Iterator[None]:
    """Take all signals that end a process like Ctrl-C, and turn them into exit code 130.

    What was simulated until then is saved; a line on stderr says how much.

    Args:
        count: how many gaits, or whatever `what` says, a cache has, and how many there are in all.
        what: is counted.
    """
    interrupted = False

    def interrupt(number: int, _frame: FrameType | None) -> None:
        nonlocal interrupted
        first, interrupted = not interrupted, True
        if first or number in QUITS:  # SIGXCPU comes every second, and SIGHUP twice
            raise KeyboardInterrupt

    before = {number: signal.signal(number, interrupt) for number in ending_signals()}
    try:
        yield
    except KeyboardInterrupt:
        from hexctl.study.landscapes.cache import LandscapeCache

        cache = LandscapeCache()
        saved, total = count(cache)
        print_note(
            f"interrupted: {saved} of {total} {what} are saved in {cache.folder}; the same command continues"
        )
        raise typer.Exit(INTERRUPTED) from None
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


#: More landscapes than this are counted, not named one by one.
MOST_NAMED = 12


class WithBar:
    """Shows a progress bar for as long as a block runs."""

    _bar: "Progress"

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()


class ScanProgress(WithBar):
    """Progress of a scan on stderr: a bar on a terminal, else one line."""

    def __init__(self, text: str = "asking ids") -> None:
        self._bar, self._text = make_bar(), text
        self._task: TaskID | None = None

    def show(self, asked: int, of: int) -> None:
        """Show how many have been asked."""
        if self._task is None:
            self._task = self._bar.add_task(self._text, total=of)
            if self._bar.disable:
                print_note(f"{self._text}: {of}, some seconds")
        self._bar.update(self._task, completed=asked)


class StudyProgress(WithBar):
    """Progress on stderr: a bar on a terminal, else one line per landscape.

    Args:
        notes: lines to print before the work begins.
    """

    def __init__(self, notes: Iterable[str] = ()) -> None:
        self._notes = iter(notes)
        self._bar = make_bar()
        self._task = self._bar.add_task("", total=None, visible=False)
        self._began_s: dict[str, float] = {}

    def begin(self, landscapes: "Sequence[Landscape]") -> None:
        """Show what the cache has and how many gaits are left to simulate."""
        for note in self._notes:
            self._line(note)
        self._now_s = time.perf_counter()
        left = [landscape for landscape in landscapes if not landscape.complete]
        known = [landscape for landscape in landscapes if landscape.complete]
        if len(known) > MOST_NAMED:
            self._line(f"{len(known)} of {len(landscapes)} sets of gaits: from the cache")
            known = []
        for landscape in known:
            self._line(f"{landscape.spec.title}: from the cache")
        gaits = sum(len(landscape.missing) for landscape in left)
        if gaits:
            self._stage("gaits walked (Ctrl-C stops, the same command continues)", gaits)

    def advance(self, landscape: "Landscape", gaits: int) -> None:
        """Count some gaits of a landscape."""
        title, now_s = landscape.spec.title, time.perf_counter()
        spent_s = self._began_s.get(title, 0.0) + now_s - self._now_s
        self._began_s[title], self._now_s = spent_s, now_s
        self._bar.update(self._task, advance=gaits, description=f"{title} (Ctrl-C stops, continue later)")
        if landscape.complete:
            gaits_valid = f"{int(landscape.valid.sum())} of {len(landscape.codes)} gaits valid"
            self._line(f"{title}: {gaits_valid}, {spent_s:.1f} s")

    def stage(self, what: str, total: int) -> None:
        """Begin another part of the work."""
        for note in self._notes:
            self._line(note)
        self._stage(what, total)

    def step(self) -> None:
        """Count one step of the current part."""
        self._bar.update(self._task, advance=1)

    def note(self, text: str) -> None:
        """Print a line above the bar."""
        self._line(text)

    def _stage(self, what: str, total: int) -> None:
        self._bar.remove_task(self._task)
        self._task = self._bar.add_task(what, total=total)

    def _line(self, text: str) -> None:
        print_above(self._bar, text, err=True)


def finish(planned: "PlannedWork[ResultT]", notes: Iterable[str] = ()) -> "ResultT":
    """Run what is planned, with its progress on stderr; Ctrl-C ends it with exit code 130.

    `notes` are printed before the work begins.
    """
    with interruptible(planned.saved, planned.unit), StudyProgress(notes) as progress:
        return planned.run(progress=progress)
