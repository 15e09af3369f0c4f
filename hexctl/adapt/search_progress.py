"""The progress bar of a search."""

import math
import sys
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text

from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_lines import Walk
from hexctl.adapt.sessions.walk_records import WalkRecord
from hexctl.adapt.trial_loop import OnStored

#: Walks at the usual time step that take as long as one that confirms a gait.
CONFIRMATION_WALKS = 4

_HELP = "Ctrl-C stops, --resume continues"


class SearchBar:
    """A temporary bar on stderr that counts the walks of a session."""

    def __init__(self, *, hidden: bool) -> None:
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=16),
            TextColumn("{task.completed:.0f}/{task.total:.0f} walks"),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
            speed_estimate_period=math.inf,
            disable=hidden or not sys.stderr.isatty(),
        )

    @property
    def shown(self) -> bool:
        """Whether there is a bar."""
        return not self._progress.disable

    def begin(self, session: Session) -> None:
        """Show the bar of a session, new or continued."""
        spec, done = session.spec, _walked(session)
        baseline = len(session.baseline if session.trials else spec.baseline_gaits)
        confirming = CONFIRMATION_WALKS if spec.confirmed_uncertainty_m else 0
        total = max(baseline + spec.budget + confirming, done)
        self._task = self._progress.add_task(_HELP, total=total, completed=done)
        self._progress.start()

    def advance(self, session: Session, _walk: WalkRecord | None = None) -> None:
        """Update the count of walks."""
        done = _walked(session)
        (task,) = self._progress.tasks
        self._progress.update(self._task, completed=done, total=max(task.total or 0, done))

    def print_above(self, line: Text) -> None:
        """Print a line above the bar."""
        self._progress.console.print(line, soft_wrap=True)

    def advance_and(self, on_stored: OnStored | None) -> OnStored:
        """A callback that counts a walk, and then calls another one."""

        def counted(session: Session, walk: Walk) -> None:
            self.advance(session)
            if on_stored is not None:
                on_stored(session, walk)

        return counted

    def __enter__(self) -> Self:
        return self  # the bar begins with the session

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()


def _walked(session: Session) -> int:
    return len(session.baseline) + len(session.trials) + CONFIRMATION_WALKS * len(session.confirmations)
