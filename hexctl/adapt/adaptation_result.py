"""Result of a run of an adaptation."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.adapt.sessions.search_session import Session, trials_text
from hexctl.adapt.sessions.walk_records import BaselineRecord, TrialRecord
from hexctl.control.trial_result import path_axes
from hexctl.errors import RecordingError, RobotFaultError


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class AdaptationResult:
    """Result of a run of an adaptation.

    Attributes:
        session: with all its trials.
        ended: why the search ended: `budget`, `target`, `confirmed`, `exhausted` or
            `not worth another trial`; `interrupted` by a requested stop; `stopped` by `trouble`.
        trouble: of the robot or the recordings; the session can be resumed after it.
        walked: number of trials and confirmations of this run.
        wall_s: duration of the run.
        overview: the recording that shows all trials, or None.
    """

    session: Session
    ended: str
    trouble: RobotFaultError | RecordingError | None
    walked: int
    wall_s: float
    overview: Path | None = None

    @property
    def best(self) -> TrialRecord | None:
        """The valid trial with the lowest score; None without one, as when a usual gait meets the target."""
        return self.session.best

    @property
    def trials(self) -> list[TrialRecord]:
        """All trials of the session, in the order in which they were walked."""
        return self.session.trials

    @property
    def baseline(self) -> list[BaselineRecord]:
        """Walks with the robot's usual gaits, before the first trial."""
        return self.session.baseline

    @property
    def uncertainty_m(self) -> float | None:
        """The simulation's own standard uncertainty of each end; None on a real robot, or if unknown."""
        return self.session.spec.uncertainty_m or None

    def to_dict(self) -> dict[str, Any]:
        """The result as `hexctl adapt --json` prints it."""
        return {**self.session.as_json(), "ended": self.ended, "wall_s": round(self.wall_s, 3)}

    def plot(self, ax: Any = None) -> Any:
        """Draw the paths of all trials seen from above; the result is the axes.

        Invalid trials are dotted, the best one bold, the baseline in another colour. `ax` are matplotlib
        axes, or None for a new figure. Raises MissingExtraError without matplotlib.
        """
        ax, best = path_axes(ax), self.best
        for trial in self.trials:
            path_m = np.array(trial.path_m, dtype=float).reshape(-1, 2)
            look = {"color": "C0", "linewidth": 3.0, "zorder": 3} if trial is best else {"color": "0.5"}
            style = "-" if trial.valid else ":"
            ax.plot(path_m[:, 0], path_m[:, 1], style, **look, label=f"code {trial.code}: {trial.score:g}")
        for walk in self.baseline:
            path_m = np.array(walk.path_m, dtype=float).reshape(-1, 2)
            style, label = "-" if walk.valid else ":", f"{walk.gait}: {walk.score:g}"
            ax.plot(path_m[:, 0], path_m[:, 1], style, color="C1", label=label)
        return ax

    def __repr__(self) -> str:
        best = self.best
        found = "no valid trial" if best is None else f"best code {best.code}, score {best.score:.3f}"
        after = trials_text(len(self.trials))
        return f"AdaptationResult({self.session.name}: {self.ended} after {after}, {found})"
