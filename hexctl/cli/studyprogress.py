"""How far a study is, on stderr: a bar with the time left, or one line per landscape without a terminal."""

import sys
import time
from collections.abc import Sequence
from types import TracebackType
from typing import Any, Self

import typer

from hexctl.cli.console import make_bar
from hexctl.study.landscape import Landscape

#: More landscapes than this are counted, not named one by one.
MOST_NAMED = 12


class StudyProgress:
    """Watches landscapes being simulated, and what comes after them."""

    def __init__(self) -> None:
        self._bar: Any = None
        self._task: Any = None
        self._began_s: dict[str, float] = {}

    def __enter__(self) -> Self:
        if sys.stderr.isatty():
            self._bar = make_bar()
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def begin(self, landscapes: Sequence[Landscape]) -> None:
        """Say what is known already and how many gaits there are to walk."""
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
            self._stage("gaits walked (Ctrl-C stops, the same command goes on)", gaits)

    def advance(self, landscape: Landscape, gaits: int) -> None:
        """Count some gaits of a landscape."""
        title, now_s = landscape.spec.title, time.perf_counter()
        spent_s = self._began_s.get(title, 0.0) + now_s - self._now_s
        self._began_s[title], self._now_s = spent_s, now_s
        if self._bar is not None:
            self._bar.update(self._task, advance=gaits, description=f"{title} (Ctrl-C stops, go on later)")
        if landscape.complete:
            gaits_valid = f"{int(landscape.valid.sum())} of {len(landscape.codes)} gaits valid"
            self._line(f"{title}: {gaits_valid}, {spent_s:.1f} s")

    def stage(self, what: str, total: int) -> None:
        """Begin another part of the work."""
        self._stage(what, total)

    def step(self) -> None:
        """Count one step of the part that goes on."""
        if self._bar is not None:
            self._bar.update(self._task, advance=1)

    def note(self, text: str) -> None:
        """Print a line that stays."""
        self._line(text)

    def _stage(self, what: str, total: int) -> None:
        if self._bar is not None:
            if self._task is not None:
                self._bar.remove_task(self._task)
            self._task = self._bar.add_task(what, total=total)

    def _line(self, text: str) -> None:
        if self._bar is not None:
            self._bar.console.print(text, highlight=False, markup=False)
        else:
            typer.echo(text, err=True)
