"""One recorded walk on any backend: `hexctl run` as a library call."""

import math
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cached_property
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any, Self

from hexctl.backends.base import check_stance, connection_notes
from hexctl.backends.clock import PERIOD_S
from hexctl.backends.registry import BackendOptions, make_servos
from hexctl.backends.sim.terrain import Floor, make_floor
from hexctl.backends.sim.world import DEFAULT_WORLD, World, load_world
from hexctl.control.custom_controller import check_controller, controller_name
from hexctl.control.guard import Guard
from hexctl.control.log import (
    BLOCK_TICKS,
    PACED_BLOCK_TICKS,
    Recorder,
    RecorderFailure,
    Recorders,
    TickLog,
)
from hexctl.control.monitor.monitored_walk import watched_walk
from hexctl.control.planning.leg_sets import doubt, drag, leg_set
from hexctl.control.trial import ShouldStop, run_trial
from hexctl.control.trial_plan import AUTO_ROTATION, PLAIN_TASK
from hexctl.control.trial_result import TrialResult
from hexctl.control.walks.ground_contact import contact_notes
from hexctl.control.walks.turning import body_heading_rad, check_plan
from hexctl.errors import InputError, MissingExtraError, argument, check_type
from hexctl.files import make_folder
from hexctl.gait.gait import DEFAULT_GAIT
from hexctl.options import check_names, chosen_options
from hexctl.robot.failure import FailureEvent, check_events
from hexctl.robot.loader import RobotFile, load_robot_file
from hexctl.robot.model import Robot
from hexctl.runs.outcome import events_seen, failure_values, gait_values, tick_values, world_text
from hexctl.runs.policy_run import PolicyRun
from hexctl.runs.run_spec import RunSpec, spec_of
from hexctl.runs.walk_plan import plan_walk
from hexctl.waiting import StopRequested, comes_true, never_stop

if TYPE_CHECKING:
    from hexctl.control.custom_controller import CustomController
    from hexctl.recording.recording import Recording


#: Tolerance of a self-rotation.
MISS_RAD = math.radians(2.0)

#: How long a connected robot may take to report its position.
POSITION_COMES_S = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RunResult:
    """Result of a run.

    Attributes:
        outcome: the object that `hexctl run --json`, or `diagnose --json`, prints.
        recording_error: why the recording is incomplete, or None.
        recorder_failures: recorders that raised and were skipped from then on.
        log: every tick.
    """

    trial: TrialResult
    outcome: dict[str, Any]
    recording: Path | None
    recording_error: Exception | None
    recorder_failures: tuple[RecorderFailure, ...]
    log: TickLog

    def to_dict(self) -> dict[str, Any]:
        """The outcome, plain and finite values or None."""
        return dict(self.outcome)


class Run:
    """A run: as a context manager it connects the robot and opens the recording, `walk` walks.

    Invalid options are refused at creation, before anything is opened or moves.

    Attributes:
        broken: simulated failures, by default those of the spec, which the walk always believes.
        notes: after connecting, warnings about the robot and about options without effect.
    """

    def __init__(self, spec: RunSpec, *, controller: "CustomController | None" = None) -> None:
        """Check a spec; raises InputError, or ReachError or LimitError for an infeasible walk."""
        spec.check()
        check_controller(controller)
        self.spec = spec
        self._file: RobotFile | None = None
        if isinstance(spec.robot, Robot):
            self.robot = spec.robot
        else:
            self._file = load_robot_file(spec.robot)
            self.robot = self._file.robot
        self._policy = PolicyRun.of(spec, self.robot)
        if self._policy is not None and controller is not None:
            raise InputError(f"{argument('policy')}: got a controller too; allowed: one or the other")
        self._controller = controller or self._policy
        self.plan = plan_walk(spec, self.robot) if self._policy is None else self._policy.plan(spec)
        self._meshes = self._file.meshes if self._file is not None and spec.records else {}
        check_plan(self.robot, self.plan)
        world = DEFAULT_WORLD if spec.world is None else spec.world
        self._world = world if isinstance(world, World) else load_world(world)
        self._recovery = spec.made_recovery(failures_come=bool(spec.events or self._world.events))
        # A robot that stands ready must not wait for it.
        heading_rad = body_heading_rad(self.robot, self.plan)
        for off_rad in (0.0, -MISS_RAD, MISS_RAD):
            plan = replace(self.plan, heading_rad=heading_rad + off_rad)
            self._recovery.prepare(self.robot, plan, plan.heading_rad)
        self.broken = spec.failures
        self.notes: tuple[str, ...] = ()
        self._guard: Guard | None = None
        self._recording: Recording | None = None
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        """Connect the robot, then create the recording.

        Raises RobotFaultError for a robot that cannot be reached, InputError for a recording that cannot be
        created and for an event that changes nothing, MissingExtraError for a missing extra.
        """
        check_events(self.spec.events, self._world_events, self.broken)
        options = BackendOptions.of(
            self.spec,
            robot=self.robot,
            world=self._world,
            robot_file=self._file,
            failures=self.broken,
        )
        servos = make_servos(self.spec.backend, options)
        check_stance(servos)
        with ExitStack() as stack:
            self._guard = stack.enter_context(Guard(servos))
            self.notes = (
                *self._without_effect(),
                *self._doubts(),
                *contact_notes(self.plan.feet, self._guard.peek()),
                *connection_notes(servos, self.plan.failures),
            )
            self._suit_rotation()
            self._recording = self._open_recording()
            if self._recording is not None:
                stack.enter_context(self._recording)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:
        self._stack.__exit__(*error)

    @property
    def title(self) -> str:
        """Title of recordings and live views: robot, gait, and a task other than to walk ahead."""
        ahead = self._task in (None, PLAIN_TASK)
        return f"{self.robot.name} {self._walk_text}" + ("" if ahead else f", {self._task}")

    @property
    def _task(self) -> str | None:
        """The plan in words; None for a custom controller, which may do anything else."""
        return None if self._controller is not None else self.plan.in_words(self.robot.gait.pace_hz)

    @property
    def _what(self) -> str:
        return self._walk_text.replace(",", "").replace(" ", "-") or "gait"

    @property
    def _walk_text(self) -> str:
        gait = self.spec.gait_text if self._has_gait else None
        return " ".join(filter(None, (controller_name(self._controller), gait)))

    @property
    def _has_gait(self) -> bool:
        """A custom controller has one only if it was asked for."""
        return controller_name(self._controller) is None or self.spec.gait_text != DEFAULT_GAIT

    @property
    def robot_file(self) -> Path | None:
        """File of the robot, or None."""
        return None if self._file is None else self._file.path

    @property
    def recording_path(self) -> Path | None:
        """File of the recording; None without one, and before connecting."""
        return None if self._recording is None else self._recording.path

    @cached_property
    def floor(self) -> Floor | None:
        """Floor of the world of a simulation in this process, or None."""
        return make_floor(self._world, self.spec.seed) if self.spec.simulated else None

    @property
    def on_stand(self) -> bool:
        """Whether a stand holds the trunk, as far as is known."""
        return self.spec.simulated and self._world.on_stand

    def walk(
        self,
        *,
        recorders: Sequence[Recorder] = (),
        stop_requested: StopRequested = never_stop,
        should_stop: ShouldStop | None = None,
    ) -> RunResult:
        """Walk as specified; arguments as in `run`. An end before the first command leaves no recording.

        Raises RobotFaultError when the robot or its link fails. A fall, a stop or an incomplete recording is
        part of the result.
        """
        if self._guard is None:
            raise InputError("run: got a walk before the robot is connected; allowed: inside `with Run(...)`")
        log, recording = TickLog(), self._recording
        kept = Recorders(
            log,
            *([recording] if recording is not None else []),
            *recorders,
            block_ticks=PACED_BLOCK_TICKS if self.spec.paced else BLOCK_TICKS,
        )
        began_s = time.perf_counter()
        walk = watched_walk(self._recovery) if self._controller is None else self._controller
        try:
            trial = run_trial(
                self._guard, self.plan, walk, kept, stop_requested=stop_requested, should_stop=should_stop
            )
        finally:
            if recording is not None and not len(log):
                self._recording = None
                recording.discard()
                recording = None
        outcome = self._outcome(trial, log, time.perf_counter() - began_s)
        error = kept.error_of(recording)
        if recording is not None and error is None:
            try:
                recording.finish(trial, outcome)
            except Exception as failure:  # noqa: BLE001  the walk is done, whatever its recording raises
                error = failure
        return RunResult(
            trial=trial,
            outcome=outcome,
            recording=None if recording is None else recording.path,
            recording_error=error,
            recorder_failures=tuple(kept.failures),
            log=log,
        )

    def _without_effect(self) -> list[str]:
        end_s, rotation = self.plan.duration_s, self.spec.self_rotation
        late = [str(event) for event in self._world_events if event.at_s >= end_s]
        notes = [f"{', '.join(late)} of the world changes nothing: the end is at {end_s:g} s"] if late else []
        if self.plan.failures or rotation in (AUTO_ROTATION, "none"):
            return notes
        why = "it turns a failed leg, and six legs are good"
        return [*notes, f"--self-rotation {rotation} changes nothing: {why}"]

    def _doubts(self) -> list[str]:
        """Warn if the robot may be unable to walk with more than one failed leg."""
        plan = self.plan
        if len(plan.failures) < 2 or not plan.travel:
            return []
        found = leg_set(self.robot, plan.gait, plan.failed_legs, (plan.heading_rad,))
        dragged = drag(self.robot, plan.failures, plan.heading_rad)
        return [note for note in (doubt(found), dragged) if note is not None]

    def _suit_rotation(self) -> None:
        """Turn the failed leg away after all if `auto` relied on a line that cannot be held."""
        spec = self.spec
        unasked = spec.self_rotation == AUTO_ROTATION and spec.hold == "auto"
        taken = unasked and self.plan.self_rotation == "none" and len(self.plan.failures) == 1
        if taken and not self._position_comes():
            # The requested hold stays: the result reports why less was held.
            self.plan = replace(plan_walk(replace(spec, hold="heading"), self.robot), hold=spec.hold)
            check_plan(self.robot, self.plan)

    def _position_comes(self) -> bool:
        """The position may arrive a little after the joints."""
        guard = self._guard
        assert guard is not None  # noqa: S101  it is connected
        timeout_s = POSITION_COMES_S if self.spec.paced else 0.0
        return comes_true(lambda: guard.peek().base_position_world is not None, timeout_s, poll_s=PERIOD_S)

    def _open_recording(self) -> "Recording | None":
        if self.spec.record is not None:
            return self._recording_at(Path(self.spec.record))
        if self.spec.record_folder is None:
            return None
        while True:
            path = self._new_path(Path(self.spec.record_folder))
            try:
                return self._recording_at(path)
            except InputError:
                if not path.exists():
                    raise
                # Another run has taken the name in the meantime.

    def _recording_at(self, path: Path) -> "Recording":
        from hexctl.recording.recording import Recording

        try:
            return Recording(
                path,
                self.robot,
                self.plan,
                title=self.title,
                floor=self.floor,
                meshes=self._meshes,
                watched=True,
                servos=self.spec.backend != "sim",
                on_stand=self.on_stand,
            )
        except MissingExtraError as error:
            raise MissingExtraError("recording (or walk with --no-record)", "view") from error

    def _new_path(self, folder: Path) -> Path:
        now = datetime.now().strftime("%Y%m%d-%H%M%S")
        failed = "".join(f"_leg{one.leg}-{one.kind}" for one in self.plan.failures)
        stem = f"{now}_{self.robot.name}_{self._what}{failed}"
        make_folder(folder, f"allowed: a folder, {argument('record')} FILE, or {argument('no_record')}")
        path, number = folder / f"{stem}.rrd", 2
        while path.exists():
            path, number = folder / f"{stem}_{number}.rrd", number + 1
        return path

    def _outcome(self, trial: TrialResult, log: TickLog, wall_s: float) -> dict[str, Any]:
        assert self._guard is not None  # noqa: S101  connected, or there would be no trial
        planned = (*self._world_events, *self.spec.events) if self.spec.simulated else events_seen(log)
        return {
            "gait": gait_values(self.spec, self.plan) if self._has_gait else None,
            "task": self._task,
            **failure_values(self.plan, planned, trial.duration_s),
            **trial.to_dict(),
            "ideal_yaw_change_deg": math.degrees(self.plan.turn_rate_rad_s * trial.duration_s),
            **tick_values(self._guard, log, wall_s),
            "backend": self.spec.backend,
            "sensors": list(self._guard.robot.sensors),
            "sensors_simulated_only": sorted({*self._guard.robot.sensors} - {*self.robot.sensors}),
            "robot": self.robot.name,
            "world": world_text(self.spec),
            "seed": self.spec.seed,
            "recording": None if self._recording is None else str(self._recording.path),
            "policy": None if self._policy is None else self._policy.values(),
            "options": chosen_options(self.spec),
        }

    @property
    def _world_events(self) -> tuple[FailureEvent, ...]:
        return self._world.events if self.spec.simulated else ()


def run(
    spec: RunSpec | None = None,
    *,
    controller: "CustomController | None" = None,
    recorders: Sequence[Recorder] = (),
    stop_requested: StopRequested = never_stop,
    should_stop: ShouldStop | None = None,
    **options: Any,
) -> RunResult:
    """Walk once on any backend.

        done = hexctl.run(robot="phantomx", gait="tripod", duration_s=5)
        print(done.trial.status, done.trial.distance_m)

    Args:
        spec: what to do; or the fields of `RunSpec` as keywords.
        controller: replaces the plan's own walk: a function of step and state that returns 18 joint angles
            in rad, a `Controller`, or a function that makes one of a `WalkStart`. It names the recording.
        recorders: take the ticks in blocks in addition to the recording; each fails separately.
        stop_requested: called every tick; True ends the walk with a soft stop.
        should_stop: checks the walk once a second, as in `run_trial`, such as a `Geofence`.
        options: fields of `RunSpec`, such as `failure="5:limp"` or `failure=["5:limp", "2:locked@8"]`;
            `record=False` leaves no recording.

    Raises InputError, ReachError and LimitError before anything moves, RobotFaultError for a robot or a link
    that fails.
    """
    keywords = "a RunSpec, or its fields as keywords, as run(gait='tripod')"
    check_type(spec, (RunSpec, NoneType), "run", keywords)
    if spec is not None and options:
        raise InputError(f"run: got a spec and {', '.join(options)} too; allowed: one or the other")
    check_names(run, options, RunSpec)
    with Run(spec or spec_of(options), controller=controller) as connected:
        return connected.walk(recorders=recorders, stop_requested=stop_requested, should_stop=should_stop)
