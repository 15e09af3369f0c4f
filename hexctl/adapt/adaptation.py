"""Adaptation: find a gait for a failed leg, in a session that is stored trial by trial.

    result = hexctl.adapt(failed_leg=5, budget=20)
    print(result.session.best_walk.slots, result.session.best_walk.score)

`Adaptation` does the same with separate parts: a spec from `new_spec`, a custom robot, a resumed session.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.adapt.adapt_options import AdaptOptions
from hexctl.adapt.measurement import Operator
from hexctl.adapt.objectives import ObjectiveChoice, as_objective
from hexctl.adapt.optimizer import OptimizerChoice
from hexctl.adapt.reset_free import ResetFreeRunner, arena_of, at_home, connected_robot, yaw_note
from hexctl.adapt.runner import TrialRunner, at_finer_step, check_not_interrupted, remove_unfinished
from hexctl.adapt.search import check_parts, extended, new_spec
from hexctl.adapt.search_progress import SearchBar
from hexctl.adapt.sessions.search_session import Session, trials_text
from hexctl.adapt.sessions.session_optimizer import make_search
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.sessions.store import RUNS, SessionStore, load_session
from hexctl.adapt.sessions.walk_records import BaselineRecord, TrialRecord
from hexctl.adapt.setting import (
    Note,
    Setting,
    baseline_note,
    budget_note,
    load_setting,
    log_note,
    start_note,
)
from hexctl.adapt.stance import with_stance
from hexctl.adapt.trial_loop import AdaptLoop, OnStored
from hexctl.backends.base import LegServos
from hexctl.control.guard import Guard
from hexctl.control.planning.static_stability import margin_m_of, stable_slots_of
from hexctl.control.telemetry_watch import SeenWarnings
from hexctl.control.trial import STOP_REQUESTED
from hexctl.control.trial_result import path_axes
from hexctl.errors import HexctlError, RecordingError, RobotFaultError, check_callable, check_type
from hexctl.gait.gait import AUTO, NAMED_SLOTS
from hexctl.options import check_names
from hexctl.recording.live import LiveView
from hexctl.recording.rrd import check_utf8
from hexctl.waiting import StopRequested, never_stop

OnBegin = Callable[[Session], None]


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
        """The valid trial with the lowest score; None without one."""
        return self.session.best

    @property
    def trials(self) -> list[TrialRecord]:
        """All trials of the session, in the order in which they were walked."""
        return self.session.trials

    @property
    def baseline(self) -> list[BaselineRecord]:
        """Walks with the robot's usual gaits, before the first trial."""
        return self.session.baseline

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


class Adaptation:
    """A new or resumed session: its spec, its robot and its folder.

    Invalid options are refused before a session exists and before anything moves.
    """

    def __init__(
        self,
        spec: SessionSpec,
        *,
        folder: Path | str = RUNS,
        record: bool = True,
        servos: LegServos | None = None,
        optimizer: OptimizerChoice | None = None,
        objective: ObjectiveChoice | None = None,
        operator: Operator | None = None,
        live: Callable[[], LiveView | None] | None = None,
        note: Note = log_note,
    ) -> None:
        """Prepare a new session.

        Args:
            spec: from `new_spec`, or a `SessionSpec` with the fingerprint of its robot.
            folder: of the session store, the recordings and the priors.
            record: whether to record each trial, and an overview.
            servos: the robot, not connected yet; None makes it by `spec.backend`.
            optimizer: its class, if it cannot be imported by the name in the spec.
            objective: the objective, if it cannot be imported by the name in the spec.
            operator: places the robot and measures, needed with `spec.ask`.
            live: makes a view of the trials of a connected robot; may return None.
            note: called with messages for a person; by default they are logged.

        Raises InputError for parts that contradict one another.
        """
        check_type(spec, SessionSpec, "spec", "a SessionSpec, as new_spec(failed_leg=5) gives")
        check_callable(live, "live", "a function that makes a LiveView, or None")
        check_callable(note, "note", "a function of a text")
        check_parts(spec, servos, optimizer, objective, operator)
        self.spec = spec
        self._folder, self._record = Path(folder), record
        self._servos, self._operator, self._live, self._note = servos, operator, live, note
        self._seen = SeenWarnings()
        self._optimizer = None if isinstance(optimizer, str) else optimizer
        self._objective = as_objective(spec.objective if objective is None else objective)
        self._resumed: Session | None = None
        self._budget: int | None = None
        self._given: set[str] = set()
        self._trust = False

    @classmethod
    def resume(
        cls,
        name: str | Session,
        *,
        budget: int | None = None,
        folder: Path | str = RUNS,
        trust: bool = False,
        **options: Any,
    ) -> "Adaptation":
        """Prepare to continue a session; `run` returns one that has ended unchanged.

        Another budget continues a session that has spent its own.

        Args:
            name: or the session itself, as `load_session` returns it.
            trust: allows a session to import the code that it names (`module:Name`), except parts in
                `options`.
            options: those of `Adaptation`.

        Raises InputError for an unknown name, a budget that is spent already, and code that is not trusted.
        """
        session = name if isinstance(name, Session) else load_session(name, folder)
        given = {part for part, value in options.items() if value is not None}
        session.spec.check_trusted(given, trust=trust)
        spec = session.spec if budget is None else extended(session, budget)
        adaptation = cls(spec, folder=folder, **options)
        adaptation._resumed, adaptation._budget = session, budget
        adaptation._given, adaptation._trust = given, trust
        return adaptation

    def _finished(self) -> Session | None:
        """The resumed session if it has ended; another budget continues one that has spent its own."""
        resumed = self._resumed
        if resumed is None or (self._budget is not None and resumed.ended in (None, "budget")):
            return None
        return None if resumed.ended is None else resumed

    def run(
        self,
        *,
        on_begin: OnBegin | None = None,
        on_stored: OnStored | None = None,
        stop_requested: StopRequested = never_stop,
    ) -> AdaptationResult:
        """Search until the session ends; the result reports trouble with the robot or the recordings.

        Args:
            on_begin: called with the session before its first trial of this run.
            on_stored: called with the session and each walk, once it is stored: a trial, a walk of the
                baseline, or one that confirms a gait.
            stop_requested: called every tick; True stops the robot softly and ends the run.

        Raises InputError for invalid input, RobotFaultError or RobotStoppedError for a robot
        that cannot be used, NotBegunError for a stop request, all before a session exists; StoreError when a
        trial cannot be stored.
        """
        check_callable(on_begin, "on_begin", "a function of the session, or None")
        check_callable(on_stored, "on_stored", "a function of the session and a walk, or None")
        check_callable(stop_requested, "stop_requested", STOP_REQUESTED)
        began_s = time.perf_counter()
        if (done := self._finished()) is not None:
            if on_begin is not None:
                on_begin(done)
            took_s, ended = time.perf_counter() - began_s, done.ended or ""
            return AdaptationResult(session=done, ended=ended, trouble=None, walked=0, wall_s=took_s)
        setting = load_setting(self.spec)  # before anything is written
        if self._record:
            check_utf8(self._folder)
            _ = setting.robot_file.meshes
        if self._resumed is None:
            check_not_interrupted(stop_requested)
        store = SessionStore(self._folder)
        with ExitStack() as stack:
            session, servos = self._begin(store, stack, setting, stop_requested)
            before = len(session.trials) + len(session.confirmations)
            if on_begin is not None:
                on_begin(session)
            with self._view(servos) as live:
                folder = store.folder_of(session.name) if self._record else None
                runner = TrialRunner(
                    spec=session.spec,
                    setting=setting,
                    folder=folder,
                    stop_requested=stop_requested,
                    live=live,
                )
                ended, trouble = self._search(session, store, runner, servos, on_stored)
        return AdaptationResult(
            session=session,
            ended=ended,
            trouble=trouble,
            walked=len(session.trials) + len(session.confirmations) - before,
            wall_s=time.perf_counter() - began_s,
            overview=self._write_overview(session, store),
        )

    @contextmanager
    def _view(self, servos: Guard | None) -> Iterator[LiveView | None]:
        """View of the trials of a connected robot while a block runs, or None; a lost one is noted."""
        live = self._live() if self._live is not None and servos is not None else None
        with live or nullcontext():
            yield live
            if live is not None and live.lost is not None:
                self._note(f"{live.lost}; the trials are not affected")

    def _begin(
        self, store: SessionStore, stack: ExitStack, setting: Setting, stop_requested: StopRequested
    ) -> tuple[Session, Guard | None]:
        """Hold the session and connect its robot; a resumed session is held first, a new one made last."""
        session = None if self._resumed is None else self._locked_again(self._resumed.name, store, stack)
        spec = self.spec if session is None else session.spec
        begins = session is None or not session.trials
        servos = stack.enter_context(connected_robot(spec, setting, self._servos, self._note))
        if servos is not None:
            self._seen = SeenWarnings(servos.peek().warnings)  # the notes on the connection have them
        if session is None:
            spec = at_home(spec, servos)  # a robot that cannot be scored is refused before any advice
        baseline = baseline_note(spec) if begins else None
        advice = start_note(spec, setting), budget_note(spec), baseline, yaw_note(spec, servos)
        for note in filter(None, advice):
            self._note(note)
        if session is None:
            spec = with_stance(spec, setting, servos, stop_requested, self._note)
            check_not_interrupted(stop_requested)
            session = store.create(spec, stack)
        return session, servos

    def _locked_again(self, name: str, store: SessionStore, stack: ExitStack) -> Session:
        stack.enter_context(store.locked(name))
        # Loaded again under the lock: another process may have changed it. Damage is reported already.
        damage: list[HexctlError] = []
        session = self._resumed = load_session(name, store.folder, on_damage=damage.append)
        session.spec.check_trusted(self._given, trust=self._trust)
        # The recording of a trial whose line is damaged looks like that of an interrupted walk.
        for left in [] if damage else remove_unfinished(store.folder_of(name), session):
            self._note(f"removed {left}: its walk was interrupted and is repeated")
        if self._budget is not None:
            session.spec = extended(session, self._budget)
        return session

    def _search(
        self,
        session: Session,
        store: SessionStore,
        runner: TrialRunner,
        servos: Guard | None,
        on_stored: OnStored | None,
    ) -> tuple[str, RobotFaultError | RecordingError | None]:
        """Why the search ended, and trouble with the robot or the recordings."""
        spec, setting, walk = session.spec, runner.setting, runner.walk
        if servos is not None:
            walk = ResetFreeRunner(
                runner=runner,
                servos=servos,
                arena=arena_of(spec),
                operator=self._operator,
                note=self._note,
                seen=self._seen,
            ).walk
        usual_slots = dict(NAMED_SLOTS)
        if AUTO in spec.baseline_gaits and not session.trials:
            usual_slots[AUTO] = stable_slots_of(setting.robot, setting.plan)
        loop = AdaptLoop(
            session,
            store,
            make_search(spec, setting.robot, setting.plan, setting.prior, self._optimizer),
            walk,
            objective=self._objective,
            stop_requested=runner.stop_requested,
            on_stored=on_stored,
            usual_slots=usual_slots,
            margin_m_of=partial(margin_m_of, setting.robot, setting.plan),
            repeats_exactly=setting.world is not None and setting.world.repeats,
            walk_finely=None if servos is not None else at_finer_step(runner).walk,
        )
        try:
            return loop.run(), None
        except (RobotFaultError, RecordingError) as error:
            return "stopped", error

    def _write_overview(self, session: Session, store: SessionStore) -> Path | None:
        """Write the overview; errors are notes, as `hexctl view` makes it too."""
        if not self._record or not session.trials:
            return None
        from hexctl.adapt.sessions.session_viewing import write_overview

        try:
            return write_overview(session, store.folder_of(session.name))
        except Exception as error:  # noqa: BLE001  the search is done and stored, whatever its picture raises
            self._note(f"no overview: {error}")
            return None


def adapt(
    failed_leg: int | None = None,
    *,
    servos: LegServos | None = None,
    operator: Operator | None = None,
    record: bool = True,
    folder: Path | str = RUNS,
    note: Note = log_note,
    on_stored: OnStored | None = None,
    progress: bool = True,
    stop_requested: StopRequested = never_stop,
    **options: Any,
) -> AdaptationResult:
    """Find a gait for a failed leg, as `hexctl adapt` does; also called as `hexctl.adapt(...)`.

        walk = hexctl.adapt(failed_leg=5, budget=4, duration_s=5).session.best_walk
        print(walk.slots, walk.score)

    Args:
        failed_leg: 1..6, counter-clockwise from the front: short for `failure="5:locked"`.
        servos: a custom robot instead of a backend, not connected yet.
        operator: places the robot before each trial and measures after it.
        record: whether to record each trial.
        folder: of the session store, the recordings and the priors.
        note: called with messages for a person; by default they are logged.
        on_stored: called with the session and each walk, once it is stored.
        progress: whether to show a bar on stderr, if that is a terminal and no operator is asked.
        stop_requested: called every tick; True stops the robot softly and ends the run.
        options: other fields of `AdaptOptions`.

    Raises InputError for invalid input; RobotFaultError for a robot that cannot be used, or
    stops during the search (`Adaptation.resume` continues the session); RecordingError for an incomplete
    recording.
    """
    allowed = "LegServos, not connected, or None"
    check_type(servos, (LegServos, type(None)), "servos", allowed)
    check_type(folder, (str, Path), "folder", "a path")
    check_type(record, bool, "record", "True or False; recordings go into folder")
    check_type(progress, bool, "progress", "True or False")
    check_callable(on_stored, "on_stored", "a function of the session and a walk, or None")
    check_names(adapt, options, AdaptOptions)
    if servos is not None and options.get("backend", "sim") == "sim":
        options["backend"] = f"{type(servos).__module__}:{type(servos).__qualname__}"
    asked = {**options, "failed_leg": failed_leg, "ask": operator is not None}
    spec = new_spec(folder=Path(folder), note=note, **asked)
    adaptation = Adaptation(
        spec,
        folder=folder,
        record=record,
        servos=servos,
        optimizer=options.get("optimizer"),
        objective=options.get("objective"),
        operator=operator,
        note=note,
    )
    with SearchBar(hidden=not progress or operator is not None) as bar:
        result = adaptation.run(
            on_begin=bar.begin,
            on_stored=bar.advance_and(on_stored),
            stop_requested=stop_requested,
        )
    if result.trouble is not None:
        raise result.trouble
    return result
