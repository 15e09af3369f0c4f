"""A progress bar on stderr for a walk that takes its time."""

import sys
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

from hexctl.backends.clock import PERIOD_S
from hexctl.control.plan import TrialPlan

#: Ticks between two updates of the bar.
UPDATE_TICKS = 25


class WalkProgress:
    """Shows how far the walk is; silent when told so or when stderr is no terminal."""

    def __init__(self, plan: TrialPlan, *, quiet: bool) -> None:
        self._total_s = plan.duration_s
        self._quiet = quiet or not sys.stderr.isatty()
        self._ticks = 0
        self._bar: Any = None

    def __enter__(self) -> Self:
        if not self._quiet:
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                TextColumn("{task.completed:.0f} of {task.total:.0f} s"),
                TimeRemainingColumn(),
                console=Console(stderr=True),
                transient=True,
            )
            self._task = self._bar.add_task("walking (Ctrl-C stops softly)", total=self._total_s)
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def wrap(self, stop_requested: Callable[[], bool]) -> Callable[[], bool]:
        """Return the same question, which also moves the bar each time the walk asks it."""
        if self._quiet:
            return stop_requested

        def counted() -> bool:
            self._ticks += 1
            if self._ticks % UPDATE_TICKS == 0:
                self._bar.update(self._task, completed=self._ticks * PERIOD_S)
            return stop_requested()

        return counted
