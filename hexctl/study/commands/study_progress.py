"""Progress of studies and priors, and what an interrupted one keeps."""

from collections.abc import Iterable

import typer

from hexctl.cli.console import INTERRUPTED, make_bar, print_above, print_note
from hexctl.cli.progress import WithBar, interruptible
from hexctl.study.plan import PlannedWork, ResultT
from hexctl.study.walk_cache import WalkCache


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


def finish(planned: PlannedWork[ResultT], notes: Iterable[str] = ()) -> ResultT:
    """Run planned work with its progress on stderr, after `notes`.

    All signals that end a process end it with exit code 130 and a line on the saved walks.
    """
    try:
        with interruptible(), StudyProgress(notes) as progress:
            return planned.run(progress=progress)
    except KeyboardInterrupt:
        cache = WalkCache()
        saved, total = planned.saved(cache)
        kept = f"{saved} of {total} walks are saved in {cache.folder}"
        print_note(f"interrupted: {kept}; the same command continues")
        raise typer.Exit(INTERRUPTED) from None
