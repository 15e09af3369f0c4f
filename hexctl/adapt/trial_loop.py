"""The loop of trials: ask for a gait, walk it, tell the score, store the trial."""

from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field
from itertools import takewhile
from typing import Any

import numpy as np

from hexctl.adapt.objectives import OBJECTIVES, Objective
from hexctl.adapt.optimizer import Observation, Optimizer, Trim
from hexctl.adapt.runner import (
    InterruptedTrialError,
    LegFailedError,
    RobotStoppedError,
    TrialRequest,
    WalkedTrial,
    WalkTrial,
    noticed_legs,
)
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_lines import Walk
from hexctl.adapt.sessions.store import SessionStore
from hexctl.adapt.sessions.walk_records import BASELINE_INDEX, BaselineRecord, ConfirmationRecord, TrialRecord
from hexctl.adapt.space import GaitSpace
from hexctl.control.scoring.uncertainty_store import CONFIRM_STEP_S
from hexctl.control.stop_reason import reason_in_words
from hexctl.control.trial import Enough
from hexctl.errors import HexctlError, InputError, RecordingError, argument
from hexctl.gait.encoding import Slots
from hexctl.gait.gait import NAMED_SLOTS
from hexctl.waiting import StopRequested, never_stop

#: Ticks between two stored points of a path: 5 Hz.
PATH_STRIDE = 10

#: Why a search ended whose optimizer expects too little of another trial.
NOT_WORTH = "not worth another trial"


#: Called with the session and a walk, once it is stored: a trial, a walk of the baseline or a confirmation.
OnStored = Callable[[Session, Walk], None]


@dataclass(slots=True)
class AdaptLoop:
    """Continues a session until its budget is spent, its target reached, or a stop requested.

    Each trial is stored with the optimizer's state before the next one starts: an interrupted session
    continues to the same end.

    Attributes:
        usual_slots: of the gaits of a baseline, by name.
        repeats_exactly: whether a second walk would end as the first one.
        walk_finely: walks at the time step `CONFIRM_STEP_S`; None on a real robot.
    """

    session: Session
    store: SessionStore
    optimizer: Optimizer
    walk: WalkTrial
    _: KW_ONLY
    objective: Objective = OBJECTIVES["final"]
    stop_requested: StopRequested = never_stop
    on_stored: OnStored | None = None
    usual_slots: Mapping[str, Slots] = field(default_factory=lambda: NAMED_SLOTS)
    margin_m_of: Callable[[Slots], float | None] = lambda _slots: None
    walk_finely: WalkTrial | None = None
    repeats_exactly: bool = False

    def __post_init__(self) -> None:
        if self.session.optimizer_state is not None:
            self.optimizer.restore(self.session.optimizer_state)

    def run(self) -> str:
        """Run trials and return why the search ended.

        `budget`, `target`, `confirmed` (the optimizer is sure of a gait), `exhausted`, `not worth another
        trial` (the expected gain is too small) or `interrupted`. Raises InputError when the objective fails;
        RobotStoppedError when the robot stopped; RecordingError after a trial with an incomplete recording:
        the trial is stored, unless it was interrupted.
        """
        self.session.settled_on = None
        self._store_end(None)
        try:
            self._walk_baseline()
            ended = self._search()
            self._confirm()
            self._confirm_finely()
        except InterruptedTrialError:
            ended = "interrupted"
        self._note_settled()
        self._store_end(None if ended == "interrupted" else ended)
        return ended

    def _store_end(self, ended: str | None) -> None:
        self.session.ended = ended
        self.store.keep(self.session)

    def _check_stop(self) -> None:
        if self.stop_requested():
            raise InterruptedTrialError

    def _walk_baseline(self) -> None:
        """Walk the missing gaits of the baseline."""
        session, optimizer = self.session, self.optimizer
        walked = {walk.gait for walk in session.baseline}
        for name in [] if session.trials else session.spec.baseline_gaits:
            if name in walked:
                continue
            self._check_stop()
            slots = self.usual_slots[name]
            code = _code_of(optimizer.space, slots)
            request = TrialRequest(index=BASELINE_INDEX, code=code or 0, slots=slots, usual=name)
            one, measured = self._walked(self.walk, request, f"the baseline {name}")
            record = BaselineRecord(gait=name, code=code, margin_m=self.margin_m_of(slots), **measured)
            if learns := optimizer.trims and code is not None:
                optimizer.repeat(code, record.score, Observation.of(one.result))
            self._keep(record, one, optimizer.state() if learns else None)

    def _search(self) -> str:
        spec = self.session.spec
        while len(self.session.trials) < spec.budget - spec.confirm:
            if self._reached():
                return "target"
            if self.optimizer.finished:
                return "confirmed"
            if not self.optimizer.worthwhile:
                return NOT_WORTH
            if self.optimizer.exhausted:
                return "exhausted"
            self._check_stop()
            if (last := self._to_confirm()) is not None:
                self._try(last.code, trim=last.trim, confirms=True)
            else:
                (code,) = self.optimizer.ask(1)
                should_stop = self.optimizer.early_stopping(code) if spec.early_stop else None
                self._try(code, should_stop)
        if self.optimizer.finished:
            return "confirmed"
        return "target" if self._reached() else "budget"

    def _note_settled(self) -> None:
        code = self.optimizer.recommended()
        predicted = self.optimizer.predict(code) if code is not None else None
        self.session.settled_on = None if predicted is None else {"code": code, **predicted.as_json()}

    def _reached(self) -> bool:
        """Whether the best trial so far is within the target, unless the optimizer judges that.

        Trimmed walks are within it once one repeats.
        """
        session, optimizer, target_m = self.session, self.optimizer, self.session.spec.target_m
        if optimizer.judges_target or target_m is None:
            return False
        if optimizer.trims:
            return any(trial.score <= target_m and self._is_confirmed(trial) for trial in session.trials)
        return session.met_target

    def _is_confirmed(self, trial: TrialRecord) -> bool:
        return self.repeats_exactly or trial.confirms

    def _to_confirm(self) -> TrialRecord | None:
        """The last trial, if it was trimmed to within the target and has to repeat that."""
        trials, target_m = self.session.trials, self.session.spec.target_m
        if not (self.optimizer.trims and trials) or target_m is None:
            return None
        return trials[-1] if trials[-1].score <= target_m and not self._is_confirmed(trials[-1]) else None

    def _confirm(self) -> None:
        """Repeat the best gait as often as asked."""
        session, spec = self.session, self.session.spec
        while len(session.trials) < spec.budget:
            repeats = takewhile(lambda trial: trial.confirms, reversed(session.trials))
            if len(list(repeats)) >= spec.confirm:
                return
            best = session.best
            code = self.optimizer.recommended() or (best.code if best else None)
            if code is None:
                return
            trim = best.trim if best and self.optimizer.trims else None
            self._try(code, trim=trim, confirms=True)

    def _confirm_finely(self) -> None:
        while self.walk_finely is not None and (found := self.session.next_to_confirm) is not None:
            self._check_stop()
            again = found.walk
            index = again.index if isinstance(again, TrialRecord) else BASELINE_INDEX
            request = TrialRequest(index=index, code=again.code or 0, slots=again.slots)
            one, measured = self._walked(self.walk_finely, request, f"the confirmation of gait {again.code}")
            record = ConfirmationRecord(
                code=again.code, margin_m=again.margin_m, time_step_s=CONFIRM_STEP_S, **measured
            )
            self._keep(record, one)

    def _try(
        self,
        code: int,
        should_stop: Enough | None = None,
        *,
        trim: Trim | None = None,
        confirms: bool = False,
    ) -> None:
        """Walk a code as the next trial, learn from it and store it.

        The trim is the optimizer's by default.
        """
        optimizer, trials, slots = self.optimizer, self.session.trials, self.optimizer.space.slots_of(code)
        index = trials[-1].index + 1 if trials else 1
        predicted = optimizer.predict(code)
        request = TrialRequest(
            index=index,
            code=code,
            slots=slots,
            trim=optimizer.trim(code) if trim is None else trim,
            stride=optimizer.stride(code),
            should_stop=should_stop,
        )
        what = f"trial {index}"
        walked, measured = self._walked(self.walk, request, what, f"{what}, gait {code}")
        score, seen = measured["score"], Observation.of(walked.result)
        if confirms:
            optimizer.repeat(code, score, seen)
        else:
            optimizer.tell([code], [score], [seen])
        trial = TrialRecord(
            index=index,
            code=code,
            margin_m=self.margin_m_of(slots),
            **measured,
            stride=request.stride,
            confirms=confirms,
            expected=None if predicted is None else predicted.as_json(),
        )
        self._keep(trial, walked, optimizer.state())

    def _walked(
        self, walk: WalkTrial, request: TrialRequest, what: str, scored: str = ""
    ) -> tuple[WalkedTrial, dict[str, Any]]:
        """A walk that was not interrupted, and the fields of its record."""
        walked = _counted(walk(request), what)
        points = np.round(walked.result.path_m[::PATH_STRIDE], 4)
        return walked, {
            "slots": request.slots,
            "score": self._scored(walked, scored or what),
            "outcome": walked.result.to_dict(),
            "path_m": points[np.isfinite(points).all(axis=1)].tolist(),
            "recording": None if walked.recording is None else str(walked.recording),
        }

    def _scored(self, walked: WalkedTrial, what: str) -> float:
        """Score of a walk; raises InputError when the objective fails: the walk can be repeated."""
        try:
            return self.objective(walked.result)
        except Exception as error:
            reason = str(error) if isinstance(error, HexctlError) else f"{type(error).__name__}: {error}"
            raise InputError(
                f"objective {self.objective.name}: failed on {what} "
                f"({' '.join(reason.split())}); the trials before it are stored: once that is corrected, "
                f"{argument('resume')} {self.session.name} walks it again"
            ) from error

    def _keep(self, record: Walk, walked: WalkedTrial, state: dict[str, Any] | None = None) -> None:
        """Store a walk and report it; raises RecordingError if its recording is incomplete."""
        self.store.add(self.session, record, state)
        if self.on_stored is not None:
            self.on_stored(self.session, record)
        _check_recording(walked, f"{record.name} is done")


def _code_of(space: GaitSpace, slots: Slots) -> int | None:
    try:
        return space.code_of(slots)
    except InputError:
        return None


def _counted(walked: WalkedTrial, what: str) -> WalkedTrial:
    """A walk that was not interrupted.

    Raises RobotStoppedError when the robot, not the operator, stopped it, or a leg failed; RecordingError if
    the recording of an interrupted one is incomplete.
    """
    result = walked.result
    if result.status != "aborted":
        return walked
    if result.stopped != "requested":
        reason = result.stopped or "for no known reason"
        if legs := tuple(one.failure.leg for one in noticed_legs(result)):
            raise LegFailedError(f"{what} does not count: {reason}", reason, legs)
        raise RobotStoppedError(f"{what}: the robot was stopped: {reason_in_words(reason)}", reason)
    _check_recording(walked, f"{what} was interrupted")
    raise InterruptedTrialError


def _check_recording(walked: WalkedTrial, done: str) -> None:
    error = walked.recording_error
    if error is not None:
        raise RecordingError(f"{done}, its recording is not whole: {error}") from error
