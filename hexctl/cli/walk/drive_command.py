"""`hexctl drive`: drive a robot by hand."""

import shlex
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexctl.backends.clock import realtime_priority
from hexctl.backends.registry import check_options, option_values
from hexctl.backends.sim.terrain import make_floor
from hexctl.backends.sim.world import DEFAULT_WORLD, load_world
from hexctl.cli.console import (
    DONE,
    INTERRUPTED,
    StopOnInterrupt,
    code_of_stop,
    note_no_window,
    print_message,
    print_note,
)
from hexctl.cli.render.stop_reasons import why_in_words
from hexctl.cli.shared_options import NoRecordOption, record_folder
from hexctl.cli.signature import with_options
from hexctl.control.log import PACED_BLOCK_TICKS, Recorder, Recorders
from hexctl.errors import EStopError
from hexctl.robot.failure_grammar import read_failures
from hexctl.robot.loader import load_robot_file
from hexctl.runs.run_spec import RunSpec
from hexctl.runs.walk_plan import plan_walk
from hexctl.teleop.devices import open_devices
from hexctl.teleop.drive_options import DriveOptions
from hexctl.teleop.keyboard import has_keys

if TYPE_CHECKING:
    from hexctl.client.stop_client import ReadyStop
    from hexctl.control.drive.drive import Drive
    from hexctl.robot.failure import Failure
    from hexctl.teleop.drive_session import DriveSession


@with_options(DriveOptions, rare=("failed_leg", "failure"))
def drive(
    asked: dict[str, Any],
    view: Annotated[bool, typer.Option("--view", help="Show the drive in the Rerun viewer.")] = False,
    no_record: NoRecordOption = False,
) -> None:
    """Drive a robot by hand: keyboard, gamepad, or a page for a phone.

    It stands up first. q, Ctrl-C and a closed terminal end it with the robot at a stand. Exit codes: 0 done,
    2 bad input, 3 fault of robot or link, 4 fell or was stopped, 130 interrupted.
    """
    from hexctl.control.drive.drive import Drive

    options = DriveOptions(**asked)
    record_folder(options.record, no_record=no_record)  # a drive is recorded only if --record names a file
    options.check_keys(terminal=has_keys())
    options.check()
    where = option_values(options, but=("robot", "failures"))
    where = {name: value for name, value in where.items() if value}
    failures, events = read_failures(options.failure, options.failed_leg)
    for event in events:
        check_options(options.backend, names={"events": "failure"}, events=str(event))
    if options.backend == "sim":
        where["realtime"] = True
    with ExitStack() as stack:
        shown = _recorders(stack, options, failures, view=view)
        recorders = Recorders(*shown, block_ticks=PACED_BLOCK_TICKS) if shown else None
        made = Drive(
            options.robot,
            backend=options.backend,
            gait=options.gait,
            body_raise=options.body_raise or None,
            recovery=options.recovery,
            hold=options.hold,
            level=options.level,
            feet=options.feet,
            policy=options.policy,
            failure=(*failures, *events),
            recorders=recorders,
            **where,
        )
        code = _drive(stack, made, options)
        if options.record is not None and recorders is not None and len(recorders.log):
            looked = shlex.quote(str(options.record))
            _say(f"hexctl: recorded in {options.record}; look at it with: hexctl view {looked}")
        raise typer.Exit(code)


def _why(drive: "Drive", stopped: str) -> str:
    standstill, remote = drive.guard.standstill, drive.guard.remote
    return why_in_words(
        stopped,
        None if standstill is None else standstill.duration_s,
        clear=None if remote is None else remote.link.clear_command,
    )


def _robot_stop(drive: "Drive") -> "ReadyStop | None":
    remote = drive.guard.remote
    if remote is None or remote.link.plain:
        return None
    from hexctl.client.stop_client import ReadyStop

    return ReadyStop(link=remote.link, stays=False)


def _drive(stack: ExitStack, drive: "Drive", options: DriveOptions) -> int:
    from hexctl.teleop.drive_session import DriveSession

    robot_stop = _robot_stop(drive)
    session = DriveSession(drive, robot_stop)
    interrupt = stack.enter_context(StopOnInterrupt())
    stack.enter_context(drive)
    for note in drive.notes:
        print_message(note)
    if robot_stop is not None:
        stack.callback(_say_unconfirmed, robot_stop)
        stack.enter_context(robot_stop)
    try:
        with ExitStack() as opened:
            devices = open_devices(opened, session, options, terminal=has_keys(), say=print_note)
            with realtime_priority():
                why = session.run(devices, interrupt.requested)
        if interrupt.terminal_gone:
            why = "the terminal is closed"
    except EStopError:
        why = drive.guard.stopped or "stopped"
        _say_end(session, f"the robot has stopped{_why(drive, why)}")
        return code_of_stop(why)
    rest = "the robot stands" if session.commanded else "the robot was not commanded"
    _say_end(session, f"{'ended' if why == 'q' else why}; {rest}")
    return INTERRUPTED if why == "interrupted" else DONE


def _say_unconfirmed(robot_stop: "ReadyStop") -> None:
    if robot_stop.trouble is not None:
        _say(f"hexctl: {robot_stop.trouble}; use hexctl estop or the switch")


def _say_end(session: "DriveSession", end: str) -> None:
    lines = [*(f"servos: {text}" for text in session.warned), end]
    _say("\n" + "\n".join(f"hexctl: {line}" for line in lines))


def _say(text: str) -> None:
    with suppress(OSError):
        print_note(text)


def _recorders(
    stack: ExitStack, options: DriveOptions, failures: "Sequence[Failure]", *, view: bool
) -> "list[Recorder]":
    simulated, record = options.backend == "sim", options.record
    if not view and record is None:
        return []
    from hexctl.recording.live import open_window
    from hexctl.recording.recording import Recording

    loaded = load_robot_file(str(options.robot))
    floor = make_floor(load_world(str(options.world or DEFAULT_WORLD)), options.seed) if simulated else None
    drive = RunSpec(
        gait=options.gait,
        failure=failures,
        self_rotation="none",
        turn_rate_rad_s=0.0,  # the robot begins on the spot
        hold="none",
        level=options.level,
        feet=options.feet,
        duration_s=86_400.0,  # only the driver ends a drive
    )
    plan = plan_walk(drive, loaded.robot)
    title, servos = f"{loaded.robot.name} driven", not simulated
    common: dict[str, Any] = {"title": title, "floor": floor, "watched": True, "servos": servos}
    found: list[Recorder] = []
    if record is not None:
        recording = Recording(record, loaded.robot, plan, meshes=loaded.meshes, **common)
        found.append(stack.enter_context(recording))
    if view and (live := open_window(note_no_window)) is not None:
        stack.enter_context(live)
        live.begin(loaded.robot, plan, looks=str(loaded.path), **common)
        found.append(live)
    return found
