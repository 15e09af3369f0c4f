"""What `hexctl run` does with its options: check everything, walk, record, report."""

import json
import time
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from hexctl.backends.base import LegServos, connection_notes
from hexctl.backends.clock import request_realtime_priority
from hexctl.backends.registry import BackendOptions, check_options, make_servos
from hexctl.backends.sim.terrain import Floor, make_floor
from hexctl.backends.sim.world import World, load_world
from hexctl.cli.console import (
    INTERRUPTED,
    RUNS,
    StopOnInterrupt,
    code_of,
    note_no_window,
    print_note,
    print_result,
)
from hexctl.cli.progress import WalkProgress
from hexctl.cli.render import report, summary
from hexctl.control.guard import Guard
from hexctl.control.log import BLOCK_TICKS, PACED_BLOCK_TICKS, Recorders, TickLog
from hexctl.control.plan import TrialPlan
from hexctl.control.result import TrialResult
from hexctl.control.trial import run_trial
from hexctl.control.turning import check_plan
from hexctl.errors import (
    InputError,
    LimitError,
    MissingExtraError,
    ReachError,
    RecordingError,
    RobotFaultError,
)
from hexctl.record.rrd import probe_file
from hexctl.robot.loader import RobotFile
from hexctl.robot.meshes import Meshes
from hexctl.robot.model import Robot

if TYPE_CHECKING:
    from hexctl.record.live import LiveView
    from hexctl.record.recording import Recording


#: A simulated walk shorter than this needs no progress bar.
SHORT_S = 120.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """The options of `hexctl run` as values."""

    backend: str
    robot: Robot
    world: str | None
    plan: TrialPlan
    gait_text: str
    realtime: bool
    record: Path | None
    no_record: bool
    view: bool
    seed: int
    robot_file: RobotFile
    meshes: Meshes
    connect: str | None
    credentials: Path | None
    insecure: bool
    link: str | None
    as_json: bool

    @property
    def simulated(self) -> bool:
        """Return whether the robot is a simulation."""
        return self.backend == "sim"

    @property
    def shows_live(self) -> bool:
        """Return whether the walk is shown while it goes on; one that runs ahead of time is shown after."""
        return self.view and not self.as_fast_as_possible

    @property
    def as_fast_as_possible(self) -> bool:
        """Return whether no wall clock paces the walk."""
        return self.simulated and not self.realtime


def execute(request: Request) -> int:
    """Walk as requested, print what came of it, and return the exit code."""
    world = _check(request)
    with ExitStack() as stack:
        interrupt = stack.enter_context(StopOnInterrupt())
        servos = _servos(request, world)
        try:
            guard = stack.enter_context(Guard(servos))
        except RobotFaultError:
            if interrupt.requested():
                return INTERRUPTED
            raise
        for note in connection_notes(servos, request.plan.failure):
            print_note(f"hexctl: {note}")
        recording = _open_recording(request, world)
        if recording is not None:
            stack.enter_context(recording)
        live = _open_live(request, world) if request.shows_live else None
        if live is not None:
            stack.enter_context(live)
        result, outcome, trouble = _walk(request, guard, recording, live, interrupt)
    print_result(*([json.dumps(outcome)] if request.as_json else summary(outcome)))
    if trouble is not None:
        raise RecordingError(f"the walk is done, its recording is not whole: {trouble}") from trouble
    if live is not None and live.lost is not None:
        print_note(f"hexctl: {live.lost}; the walk and its recording are whole")
    elif live is not None and not interrupt.requested():
        print_note("close the viewer, or press Ctrl-C, to end")
        live.wait()
    elif request.view and not request.shows_live and recording is not None and not interrupt.requested():
        from hexctl.record.viewer import open_viewer

        try:
            open_viewer([recording.path])
        except RecordingError as error:
            typer.echo(f"hexctl: {error}", err=True)
    return INTERRUPTED if interrupt.requested() else code_of(result)


def _check(request: Request) -> World:
    """Refuse what cannot be done before anything heavy is loaded or anything moves; return the world."""
    if request.seed < 0:
        raise InputError(f"--seed: got {request.seed}; allowed: 0 or more")
    check_options(
        request.backend,
        world=request.world,
        seed=request.seed,
        realtime=request.realtime,
        connect=request.connect,
        credentials=request.credentials,
        insecure=request.insecure,
        link=request.link,
    )
    if request.no_record and (request.record is not None or request.view):
        raise InputError("--no-record: got --record or --view too; allowed: one or the other")
    if request.record is not None:
        probe_file(request.record)
    try:
        check_plan(request.robot, request.plan)
    except (ReachError, LimitError) as error:
        raise InputError(f"{error}; ask for a smaller --amplitude, --height or --turn") from error
    return load_world("flat" if request.world is None else request.world)


def _servos(request: Request, world: World) -> LegServos:
    options = BackendOptions(
        robot=request.robot,
        world=world,
        failure=request.plan.failure,
        seed=request.seed,
        realtime=request.realtime,
        robot_file=request.robot_file,
        connect=request.connect,
        credentials=request.credentials,
        insecure=request.insecure,
        link=request.link,
    )
    return make_servos(request.backend, options)


def _walk(
    request: Request,
    guard: Guard,
    recording: "Recording | None",
    live: "LiveView | None",
    interrupt: StopOnInterrupt,
) -> tuple[TrialResult, dict[str, Any], Exception | None]:
    """Walk and return result, report, and what went wrong with the recording, which never stops a robot."""
    if not request.as_fast_as_possible:
        request_realtime_priority()
    quiet = request.as_json or (request.as_fast_as_possible and request.plan.duration_s < SHORT_S)
    progress = WalkProgress(request.plan, quiet=quiet)

    log = TickLog()
    recorders = Recorders(
        log,
        *(recorder for recorder in (progress, recording, live) if recorder is not None),
        block_ticks=BLOCK_TICKS if request.as_fast_as_possible else PACED_BLOCK_TICKS,
    )
    with progress:
        began_s = time.perf_counter()
        result = run_trial(guard, request.plan, recorders=recorders, stop_requested=interrupt.requested)
        wall_s = time.perf_counter() - began_s
    outcome = _report(request, result, log, guard, wall_s, recording)
    trouble = recorders.error_of(recording)
    if recording is not None and trouble is None:
        try:
            recording.finish(result, outcome)
        except Exception as error:  # noqa: BLE001  the walk is done, whatever its recording came to
            trouble = error
    return result, outcome, trouble


def _report(
    request: Request,
    result: TrialResult,
    log: TickLog,
    guard: Guard,
    wall_s: float,
    recording: "Recording | None",
) -> dict[str, Any]:
    facts = {
        "backend": request.backend,
        "robot": request.robot.name,
        "world": (request.world or "flat") if request.simulated else None,
        "seed": request.seed,
        "recording": None if recording is None else str(recording.path),
    }
    return report(request.plan, result, log, guard, wall_s=wall_s, gait_text=request.gait_text, facts=facts)


def _open_recording(request: Request, world: World) -> "Recording | None":
    """Return the new recording of this run, or None with --no-record."""
    if request.no_record:
        return None
    if request.record is not None:
        return _recording_at(request.record, request, world)
    while True:
        path = _new_path(request)
        try:
            return _recording_at(path, request, world)
        except InputError:
            if not path.exists():
                raise
            # Another run took the name meanwhile.


def _recording_at(path: Path, request: Request, world: World) -> "Recording":
    from hexctl.record.recording import Recording

    floor = _floor(request, world)
    title = f"{request.robot.name} {request.gait_text}"
    try:
        return Recording(path, request.robot, request.plan, title=title, floor=floor, meshes=request.meshes)
    except MissingExtraError as error:
        raise MissingExtraError("recording (or walk with --no-record)", "view") from error


def _open_live(request: Request, world: World) -> "LiveView | None":
    """Return a viewer that shows the walk of a request; None where there is no screen."""
    from hexctl.record.live import open_window

    live = open_window(note_no_window)
    if live is None:
        return None
    title = f"{request.robot.name} {request.gait_text}"
    floor = _floor(request, world)
    live.begin(request.robot, request.plan, title=title, floor=floor, looks=str(request.robot_file.path))
    return live


def _floor(request: Request, world: World) -> Floor | None:
    return make_floor(world, request.seed) if request.simulated else None


def _new_path(request: Request) -> Path:
    """Return a path under runs/ that no run has used."""
    now = datetime.now().strftime("%Y%m%d-%H%M%S")
    gait = request.gait_text.replace(",", "") if request.gait_text else "gait"
    failed = f"_leg{request.plan.failure.leg}-{request.plan.failure.kind}" if request.plan.failure else ""
    stem = f"{now}_{request.robot.name}_{gait}{failed}"
    try:
        RUNS.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{RUNS}/: cannot be used ({error.strerror}); allowed: a folder, or --record FILE"
        ) from error
    path, number = RUNS / f"{stem}.rrd", 2
    while path.exists():
        path, number = RUNS / f"{stem}_{number}.rrd", number + 1
    return path
