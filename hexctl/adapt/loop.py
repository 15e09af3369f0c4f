"""The trial-based loop: ask for a gait, walk it, keep it, tell what came of it."""

from collections.abc import Callable
from itertools import takewhile
from pathlib import Path
from typing import Protocol

import numpy as np

from hexctl.adapt.objectives import score_of
from hexctl.adapt.optimizer import Observation, Optimizer, Prediction
from hexctl.adapt.runner import RobotStoppedError
from hexctl.adapt.session import Session, TrialRecord
from hexctl.adapt.store import SessionStore
from hexctl.control.result import TrialResult
from hexctl.control.trial import Enough, StopRequested, never
from hexctl.gait.encoding import Slots
from hexctl.types import FloatArray

#: Every so many ticks a point of the path is kept with the trial: 5 Hz.
PATH_STRIDE = 10


class Walk(Protocol):
    """Walks a gait and returns the result and the recording of it."""

    def __call__(
        self, index: int, code: int, slots: Slots, enough: Enough | None = None
    ) -> tuple[TrialResult, Path | None]:
        """Walk the trial with this index, until its path has shown enough where that is asked."""


OnTrial = Callable[[Session, TrialRecord], None]


class AdaptLoop:
    """Continues a session until its budget is spent, its target reached, or a stop requested.

    Each trial is durable, together with the optimizer's state after it, before the next one starts; so a
    session that is cut off anywhere goes on as if it had not been.
    """

    def __init__(
        self,
        session: Session,
        store: SessionStore,
        optimizer: Optimizer,
        walk: Walk,
        *,
        stop_requested: StopRequested = never,
        on_trial: OnTrial | None = None,
    ) -> None:
        self._session, self._store, self._optimizer = session, store, optimizer
        self._walk = walk
        self._stop_requested, self._on_trial = stop_requested, on_trial
        if session.optimizer_state is not None:
            optimizer.restore(session.optimizer_state)

    def run(self) -> str:
        """Run trials and return why it ended.

        `budget`, `target`, `confirmed` (the optimizer is sure of a gait), `exhausted` or `interrupted`.
        """
        self._keep_end(None)
        ended = self._search()
        if ended != "interrupted" and not self._confirm():
            ended = "interrupted"
        self._note_surety()
        self._keep_end(None if ended == "interrupted" else ended)
        return ended

    def _keep_end(self, ended: str | None) -> None:
        self._session.ended = ended
        self._store.keep(self._session)

    def _search(self) -> str:
        spec = self._session.spec
        while len(self._session.trials) < spec.budget - spec.confirm:
            if self._reached():
                return "target"
            if self._optimizer.finished:
                return "confirmed"
            if self._optimizer.exhausted:
                return "exhausted"
            if self._stop_requested():
                return "interrupted"
            (code,) = self._optimizer.ask(1)
            expected = self._optimizer.expect(code)
            enough = self._optimizer.enough(code) if spec.early_stop else None
            result, recording = self._try(code, enough)
            if result.status == "aborted":
                return "interrupted"
            score = score_of(result, spec.objective)
            self._optimizer.tell([code], [score], [Observation.of(result)])
            self._keep(code, score, result, recording, expected=expected)
        if self._optimizer.finished:
            return "confirmed"
        return "target" if self._reached() else "budget"

    def _note_surety(self) -> None:
        """Keep which gait the optimizer settles on, and how sure it is of it."""
        code = self._optimizer.recommended()
        expected = self._optimizer.expect(code) if code is not None else None
        self._session.settled_on = None if expected is None else {"code": code, **expected.as_json()}

    def _reached(self) -> bool:
        """Return whether the best trial so far is within the target, and nobody else judges that."""
        if self._optimizer.judges_target:
            return False
        target_m, best = self._session.spec.target_m, self._session.best
        return target_m is not None and best is not None and best.score <= target_m

    def _confirm(self) -> bool:
        """Repeat the best gait as often as asked; return False when interrupted."""
        session, spec = self._session, self._session.spec
        while self._repeats() < spec.confirm and len(session.trials) < spec.budget:
            code = self._optimizer.recommended() or (session.best.code if session.best else None)
            if code is None:
                break
            expected = self._optimizer.expect(code)
            result, recording = self._try(code)
            if result.status == "aborted":
                return False
            score = score_of(result, spec.objective)
            self._optimizer.repeat(code, score, Observation.of(result))
            self._keep(code, score, result, recording, confirms=True, expected=expected)
        return True

    def _repeats(self) -> int:
        """Return how often the best gait was repeated since the last trial of the search."""
        return sum(1 for _ in takewhile(lambda trial: trial.confirms, reversed(self._session.trials)))

    def _try(self, code: int, enough: Enough | None = None) -> tuple[TrialResult, Path | None]:
        """Walk a code; raises RobotStoppedError when the robot, not the operator, stopped it."""
        index = len(self._session.trials) + 1
        result, recording = self._walk(index, code, self._optimizer.space.slots_of(code), enough)
        if result.status == "aborted" and result.stopped != "requested":
            reason = result.stopped or "for no known reason"
            raise RobotStoppedError(f"trial {index}: the robot was stopped: {reason}", reason)
        return result, recording

    def _keep(
        self,
        code: int,
        score: float,
        result: TrialResult,
        recording: Path | None,
        *,
        confirms: bool = False,
        expected: Prediction | None = None,
    ) -> None:
        """Make the trial durable and say so."""
        trial = TrialRecord(
            index=len(self._session.trials) + 1,
            code=code,
            slots=self._optimizer.space.slots_of(code),
            score=score,
            outcome=result.numbers(),
            path_m=_kept(result.path_m),
            recording=None if recording is None else str(recording),
            confirms=confirms,
            expected=None if expected is None else expected.as_json(),
        )
        self._store.add_trial(self._session, trial, self._optimizer.state())
        if self._on_trial is not None:
            self._on_trial(self._session, trial)


def _kept(path_m: FloatArray) -> list[list[float]]:
    """Return what is kept of a path: points now and then, where there are any."""
    points = np.round(path_m[::PATH_STRIDE], 4)
    kept: list[list[float]] = points[np.isfinite(points).all(axis=1)].tolist()
    return kept
