"""`hexctl run`: walk."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexctl.backends.clock import PERIOD_S
from hexctl.cli.console import (
    INTERRUPTED,
    code_of,
    make_bar,
    note_no_window,
    print_above,
    print_message,
    print_note,
    print_result,
)
from hexctl.cli.interrupts import NOT_CONFIRMED
from hexctl.cli.progress import WithBar
from hexctl.cli.results.view_command import view_afterwards
from hexctl.cli.settings import runs_folder
from hexctl.cli.shared_options import (
    JsonOption,
    NoRecordOption,
    RecoverOption,
    WalkArenaOption,
    chosen_recovery,
    geofence,
    record_folder,
)
from hexctl.cli.signature import with_options
from hexctl.cli.walk.connected_run import check_commanded, clear_command, connected
from hexctl.cli.walk.diagnose_command import FirstDiagnosis, diagnose_first
from hexctl.control.walks.turning import SMALL_TURN_RAD, turn_needed_rad
from hexctl.errors import InputError, LimitError, ReachError, RecordingError
from hexctl.recording.live import LiveView, open_window
from hexctl.robot.failure_grammar import AUTO_LEG
from hexctl.runs.run_spec import RunSpec

if TYPE_CHECKING:
    from hexctl.control.log import Recorder, TickLog
    from hexctl.control.trial import ShouldStop
    from hexctl.runs.run import Run

#: Moments of an interrupt.
BEFORE, DURING, AFTER = "before the walk", "without a soft stop", "after the walk"

#: Texts of the phases of a walk.
DOING = {
    "settle": "standing up (Ctrl-C stops)",
    "turn": "turning to the walk's start (Ctrl-C stops)",
    "walk": "walking (Ctrl-C stops)",
    "stop": "stopping",
}


@with_options(RunSpec)
def run(
    walk: dict[str, Any],
    recover: RecoverOption = False,
    arena: WalkArenaOption = None,
    no_record: NoRecordOption = False,
    view: Annotated[
        bool,
        typer.Option(
            "--view",
            help="Show the walk in the Rerun viewer: during the walk with --realtime or on a robot, "
            "otherwise afterwards.",
        ),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Walk, record the walk, and report the result.

    Ctrl-C stops softly and keeps the recording. Exit codes: 0 done (even without progress), 2 bad input,
    3 fault of robot or link, 4 fell or was stopped, 130 interrupted.
    """
    if no_record and view:
        raise InputError("--no-record: got --view too; allowed: one or the other")
    progress = _WalkProgress(walk["duration_s"], quiet=as_json)
    with _reporting_interrupts(progress), progress:
        walk["recovery"] = chosen_recovery(recover=recover, recovery=walk["recovery"])
        spec = RunSpec(**walk, record_folder=record_folder(walk["record"], no_record=no_record))
        fence = None if arena is None else geofence(arena, str(spec.robot), simulated=spec.simulated)
        found = None
        if spec.failed_leg == AUTO_LEG:
            spec.check()
            progress.pause()
            found = diagnose_first(spec)
            spec = found.walk_spec(spec)
        raise typer.Exit(
            _walk(_with_best(spec), progress, view=view, as_json=as_json, found=found, fence=fence)
        )


@contextmanager
def _reporting_interrupts(progress: "_WalkProgress") -> Iterator[None]:
    """End the command at an interrupt that is no soft stop, and print what is recorded."""
    try:
        yield
    except KeyboardInterrupt:
        print_message(progress.interrupted())
        raise typer.Exit(INTERRUPTED) from None


def _with_best(spec: RunSpec) -> RunSpec:
    """Spec with `best` replaced by gaits of sessions, which a note names."""
    if not spec.asks_for_best:
        return spec
    from hexctl.adapt.best import best_gait

    best = best_gait(spec, runs_folder())
    print_message(best.source)
    return best.spec


def _walk(
    spec: RunSpec,
    progress: "_WalkProgress",
    *,
    view: bool,
    as_json: bool,
    found: FirstDiagnosis | None,
    fence: "ShouldStop | None",
) -> int:
    from hexctl.cli.render.run_output import summary

    run, clear = _checked(spec), clear_command(spec)
    progress.run = run
    if found is not None:
        run.broken = found.broken
    with progress, connected(run) as interrupt, ExitStack() as stack:
        live = _open_live(run) if view and spec.paced and not interrupt.requested() else None
        if live is not None:
            stack.enter_context(live)
        progress.of_turn = _turn_note(run) if spec.paced else ""
        recorders: list[Recorder] = [progress] if live is None else [progress, live]
        progress.moment = DURING
        done = run.walk(recorders=recorders, stop_requested=interrupt.requested, should_stop=fence)
        progress.moment = AFTER
        check_commanded(done.outcome)
    if found is not None:
        done.outcome["diagnosis"] = found.result.diagnosis.to_dict()
    print_result(*([done.outcome] if as_json else summary(done.outcome, clear)))
    if (error := done.recording_error) is not None:
        raise RecordingError(f"the walk is done, its recording is not whole: {error}") from error
    if live is not None and live.lost is not None:
        print_message(f"{live.lost}; the walk and its recording are whole")
    elif view and not interrupt.requested():
        _show(live, None if spec.paced else done.recording)
    return INTERRUPTED if interrupt.requested() else code_of(done.trial)


def _checked(spec: RunSpec) -> "Run":
    from hexctl.runs.run import Run

    try:
        return Run(spec)
    except (ReachError, LimitError) as error:
        raise InputError(f"{error}; ask for a smaller --amplitude, --height or --turn") from error


def _open_live(run: "Run") -> "LiveView | None":
    live = open_window(note_no_window)
    if live is not None:
        looks = None if run.robot_file is None else str(run.robot_file)
        live.begin(
            run.robot,
            run.plan,
            title=run.title,
            floor=run.floor,
            looks=looks,
            watched=True,
            servos=run.spec.backend != "sim",
        )
    return live


def _show(live: "LiveView | None", recording: Path | None) -> None:
    """Wait for a live view, or open the recording of a walk without one."""
    if live is not None:
        print_note("close the viewer, or press Ctrl-C, to end")
        live.wait()
    elif recording is not None:
        view_afterwards(str(recording))


def _turn_note(run: "Run") -> str:
    """Line about the self-rotation before a walk; empty if it is short."""
    plan = run.plan
    if not plan.failures or abs(turn_needed_rad(run.robot, plan)) <= SMALL_TURN_RAD:
        return ""
    points = "trails" if plan.self_rotation == "rear" else "leads"
    first = f"turns until leg {plan.failures[0].leg} {points}"
    return f"hexctl: {first}, then walks {plan.duration_s:g} s; Ctrl-C stops it"


class _WalkProgress(WithBar):
    """Progress on stderr during load and walk.

    Attributes:
        of_turn: printed if the robot turns first.
        moment: when an interrupt comes that is no soft stop.
    """

    #: A second: drawing must not delay the ticks.
    block_ticks: int | None = 50

    def __init__(self, total_s: float, *, quiet: bool) -> None:
        self.of_turn, self.moment = "", BEFORE
        self.run: Run | None = None
        self._total_s = total_s
        self._bar = make_bar("{task.fields[walked]}", quiet=quiet)
        self._task = self._bar.add_task("loading", total=None, walked="")

    def interrupted(self) -> str:
        """Line about an interrupt that is no soft stop, with the recording."""
        path = None if self.run is None else self.run.recording_path
        parts = [f"interrupted {self.moment}"]
        if self.moment == BEFORE:
            parts.append(": nothing was recorded")
        elif path is not None:
            parts.append(f"; recorded{'' if self.moment == AFTER else ' until then'}: {path}")
        if self.moment == DURING and self.run is not None and not self.run.spec.simulated:
            parts.append(f". {NOT_CONFIRMED}")
        return "".join(parts)

    def pause(self) -> None:
        self._bar.stop()

    def write_block(self, log: "TickLog", start: int, stop: int) -> None:
        if self.of_turn and log.phase == "turn":
            print_above(self._bar, self.of_turn, err=True)
            self.of_turn = ""
        walked_s = min(self._total_s, log.walked_ticks * PERIOD_S)
        self._bar.update(
            self._task,
            completed=walked_s,
            total=self._total_s,
            description=DOING[log.phase],
            walked=f"{walked_s:.0f} of {self._total_s:.0f} s",
        )
