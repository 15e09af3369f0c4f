"""Runners of single trials: each in its own simulation, or reset-free on one connected robot."""

import re
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from hexctl.adapt.measurement import measured_by_tape
from hexctl.adapt.optimizer import Trim
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_spec import UNWATCHED, SessionSpec
from hexctl.adapt.sessions.walk_records import BASELINE_INDEX
from hexctl.adapt.setting import Setting
from hexctl.backends.registry import BackendOptions, make_servos
from hexctl.backends.sim.terrain import make_floor
from hexctl.control.controllers import Controller
from hexctl.control.guard import Guard
from hexctl.control.log import BLOCK_TICKS, PACED_BLOCK_TICKS, Recorders
from hexctl.control.monitor.monitored_walk import watched_walk
from hexctl.control.monitor.recovery import make_recovery
from hexctl.control.planning.top_speed import Stride
from hexctl.control.preparation import WalkStart
from hexctl.control.scoring.uncertainty_store import CONFIRM_STEP_S
from hexctl.control.stop_reason import reason_in_words
from hexctl.control.telemetry_watch import with_troubles
from hexctl.control.trial import Enough, ShouldStop, planned_walk, run_trial, stop_when
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import TrialResult
from hexctl.errors import HexctlError, InputError, RecordingError, RobotFaultError, argument
from hexctl.gait.encoding import Slots
from hexctl.recording.live import LiveView
from hexctl.recording.recording import Recording
from hexctl.robot.failure import NoticedFailure, in_words, loses_leg
from hexctl.waiting import StopRequested, never_stop


class InterruptedTrialError(Exception):
    """A stop was requested before a trial, or during it."""


class NotBegunError(HexctlError, RuntimeError):
    """A stop was requested before there was a session."""


def check_not_interrupted(stop_requested: StopRequested) -> None:
    """Raise NotBegunError if a stop was requested before there is a session."""
    if stop_requested():
        raise NotBegunError("interrupted before a session began: nothing was recorded, begin again")


class RobotStoppedError(RobotFaultError):
    """The guard, local or the robot's, has latched a stop; the session can be resumed after it."""

    def __init__(self, message: str, reason: str) -> None:
        super().__init__(message)
        self.reason = reason


class LegFailedError(RobotStoppedError):
    """A leg failed unexpectedly during a trial, which does not count; `legs` are ascending."""

    def __init__(self, message: str, reason: str, legs: tuple[int, ...]) -> None:
        super().__init__(message, reason)
        self.legs = legs


def check_not_stopped(servos: Guard) -> None:
    """Raise RobotStoppedError for a robot that must not move before an operator clears it."""
    if servos.stopped is not None:
        raise RobotStoppedError(f"the robot is stopped: {reason_in_words(servos.stopped)}", servos.stopped)


#: Adds to a result before it is recorded.
Completed = Callable[[TrialResult], TrialResult]


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialRequest:
    """One trial to walk.

    Attributes:
        index: of the trial; `BASELINE_INDEX` for a walk of the baseline.
        code: of the gait; 0 if its slots have none.
        usual: name of the gait of a walk of the baseline.
        trim: correction of the walk, or None.
        stride: in place of the robot's, or None.
        should_stop: ends the walk once its path shows enough, or None.
    """

    index: int
    code: int
    slots: Slots
    trim: Trim | None = None
    stride: Stride | None = None
    should_stop: Enough | None = None
    usual: str = ""

    @property
    def title(self) -> str:
        """Title of the trial, or of the walk of the baseline."""
        return f"baseline: gait {self.usual}" if self.usual else f"trial {self.index}: gait {self.code}"


@dataclass(frozen=True, slots=True, kw_only=True)
class WalkedTrial:
    """A walked trial and its recording, or None; `recording_error` is why that is incomplete."""

    result: TrialResult
    recording: Path | None = None
    recording_error: Exception | None = None


#: Walks a requested trial.
WalkTrial = Callable[[TrialRequest], WalkedTrial]


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialRunner:
    """Walks the gaits of one session in simulation, each from the same start.

    `folder` is None without recordings, `live` without a view.
    """

    spec: SessionSpec
    setting: Setting
    folder: Path | None
    stop_requested: StopRequested = never_stop
    live: LiveView | None = None

    def walk(self, request: TrialRequest) -> WalkedTrial:
        """Run one trial in its own simulation."""
        setting, plan = self.setting, self.setting.plan_for(request.slots, request.trim, request.stride)
        # The simulated failure; the plan has the one that the controller knows.
        broken = self.spec.broken
        options = BackendOptions.of(
            self.spec, robot=setting.robot, world=setting.world, failures=(broken,), trial=request.index
        )
        with Guard(make_servos(self.spec.backend, options)) as servos:
            by_tape = partial(measured_by_tape, robot=servos.robot, plan=plan)
            return self.walk_on(servos, plan, request, stop_when(request.should_stop), by_tape)

    def walk_on(
        self,
        servos: Guard,
        plan: TrialPlan,
        request: TrialRequest,
        should_stop: ShouldStop | None = None,
        completed: Completed = lambda result: result,
    ) -> WalkedTrial:
        """Run a requested trial by its plan; `completed` adds to the result before it is recorded.

        An error of the recording affects neither the walk nor its result.
        """
        with ExitStack() as stack:
            recording = self._open_recording(stack, request, plan)
            recorders = self._recorders(recording, plan, request.title)
            result = run_trial(
                servos,
                plan,
                self._made_walk(),
                recorders=recorders,
                stop_requested=self.stop_requested,
                should_stop=should_stop,
            )
            result = without_count(completed(result))
            if recording is None:
                return WalkedTrial(result=result)
            trouble = recorders.error_of(recording) or _finished(recording, result, self._facts(request))
            return WalkedTrial(result=result, recording=recording.path, recording_error=trouble)

    @property
    def _watched(self) -> bool:
        return self.spec.recovery != UNWATCHED

    def _made_walk(self) -> Callable[[WalkStart], Controller]:
        if not self._watched:
            return planned_walk
        return watched_walk(make_recovery(self.spec.recovery))

    def _recorders(self, recording: Recording | None, plan: TrialPlan, title: str) -> Recorders:
        if self.live is not None:
            self.live.begin(
                self.setting.robot,
                plan,
                title=title,
                looks=self.spec.robot,
                watched=self._watched,
                servos=not self.spec.simulated,
            )
        given = [recorder for recorder in (recording, self.live) if recorder is not None]
        return Recorders(*given, block_ticks=BLOCK_TICKS if self.spec.simulated else PACED_BLOCK_TICKS)

    def _open_recording(self, stack: ExitStack, request: TrialRequest, plan: TrialPlan) -> Recording | None:
        """Recording of a trial, or None; raises RecordingError if it cannot be written."""
        if self.folder is None:
            return None
        world, path = self.setting.world, _new_path(self.folder, _stem(request.index, request.usual))
        try:
            recording = Recording(
                path,
                self.setting.robot,
                plan,
                title=request.title,
                floor=None if world is None else make_floor(world, self.spec.seed),
                meshes=self.setting.robot_file.meshes,
                watched=self._watched,
                servos=not self.spec.simulated,
            )
        except InputError as error:
            raise _unwritable(path, error) from error
        stack.callback(recording.close)
        return recording

    def _facts(self, request: TrialRequest) -> dict[str, Any]:
        spec = self.spec
        return {
            "trial": request.index,
            "code": request.code,
            "optimizer": spec.optimizer,
            "backend": spec.backend,
            "world": spec.world,
            "seed": spec.seed,
            "options": spec.as_json(),
        }


def _unwritable(path: Path, error: InputError) -> RecordingError:
    cause = error.__cause__
    reason = cause.strerror if isinstance(cause, OSError) else str(error)
    return RecordingError(
        f"{path}: the recording cannot be written ({reason}); free some space, or continue with "
        f"{argument('no_record')}"
    )


def at_finer_step(runner: TrialRunner) -> TrialRunner:
    """Runner in the same world at the time step `CONFIRM_STEP_S`, without recordings."""
    world = runner.setting.world
    finer = None if world is None else world.model_copy(update={"time_step_s": CONFIRM_STEP_S})
    return replace(runner, setting=replace(runner.setting, world=finer), folder=None, live=None)


def without_count(result: TrialResult) -> TrialResult:
    """Mark a result invalid if another leg failed meanwhile and did not heal."""
    failed = noticed_legs(result)
    if not failed or (result.status == "aborted" and result.stopped == "requested"):
        return result
    words = (
        f"leg {one.failure.leg} {in_words(one.failure)}, noticed {one.at_s:.1f} s into it" for one in failed
    )
    legs = [one.failure.leg for one in failed]
    stopped = with_troubles(", ".join(words), result.warnings, legs)
    return replace(result, status="aborted", stopped=stopped)


def noticed_legs(result: TrialResult) -> list[NoticedFailure]:
    """Noticed failures of legs that did not heal, by leg; a weak joint is none."""
    last = {one.failure.leg: one for one in result.noticed if loses_leg(one.failure.kind)}
    return [last[leg] for leg in sorted(last) if not last[leg].healed]


def _finished(recording: Recording, result: TrialResult, facts: dict[str, Any]) -> Exception | None:
    try:
        recording.finish(result, facts)
    except Exception as error:  # noqa: BLE001  the walk is done, whether or not its recording is whole
        return error
    return None


def _stem(index: int, usual: str = "") -> str:
    """Beginning of the name of a recording: of a trial, or of a walk of the baseline."""
    return f"baseline-{usual}" if usual else f"trial-{index:03d}"


def _new_path(folder: Path, stem: str) -> Path:
    """Unused path; an interrupted walk keeps its own until its session is resumed."""
    folder.mkdir(parents=True, exist_ok=True)
    path, number = folder / f"{stem}.rrd", 2
    while path.exists():
        path, number = folder / f"{stem}-{number}.rrd", number + 1
    return path


def remove_unfinished(folder: Path, session: Session) -> list[Path]:
    """Remove recordings of the walk at which a held session was killed or interrupted: it is repeated."""
    stored = {walk.recording_in(folder) for walk in (*session.trials, *session.baseline)}
    stems = [_stem(session.trials[-1].index + 1 if session.trials else 1)]
    if not session.trials:
        stems += [_stem(BASELINE_INDEX, gait) for gait in session.spec.baseline_gaits]
    repeated = re.compile(rf"({'|'.join(map(re.escape, stems))})(-\d+)?\.rrd")
    removed = []
    for path in sorted(set(folder.glob("*.rrd")) - stored):
        if repeated.fullmatch(path.name) and not path.is_symlink():
            with suppress(OSError):
                path.unlink()
                removed.append(path)
    return removed
