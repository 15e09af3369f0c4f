"""A progress bar on stderr for a walk that takes its time."""

import sys
from types import TracebackType
from typing import Any, Self

from hexctl.backends.clock import PERIOD_S
from hexctl.cli.console import make_bar
from hexctl.control.log import BLOCK_TICKS, TickLog
from hexctl.control.plan import TrialPlan


class WalkProgress:
    """Shows how far the walk of a log is; silent when told so or when stderr is no terminal."""

    def __init__(self, plan: TrialPlan, *, quiet: bool) -> None:
        self._total_s = plan.duration_s
        self._quiet = quiet or not sys.stderr.isatty()
        self._bar: Any = None

    def __enter__(self) -> Self:
        if not self._quiet:
            self._bar = make_bar("{task.completed:.0f} of {task.total:.0f} s")
            self._task = self._bar.add_task(_doing("settle"), total=self._total_s)
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    block_ticks = BLOCK_TICKS

    def write_block(self, log: TickLog, start: int, stop: int) -> None:
        """Move the bar to where the log is, once a second; a recorder of the trial."""
        if self._bar is not None and start // BLOCK_TICKS != stop // BLOCK_TICKS:
            walked_s = min(self._total_s, log.walked_ticks * PERIOD_S)
            self._bar.update(self._task, completed=walked_s, description=_doing(log.phase))


def _doing(phase: str) -> str:
    what = {
        "settle": "standing up",
        "turn": "turning the failed leg away",
        "walk": "walking",
        "stop": "stopping",
    }
    return f"{what[phase]} (Ctrl-C stops softly)"
