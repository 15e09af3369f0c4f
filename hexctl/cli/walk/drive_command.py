"""`hexctl drive`: a robot driven by hand."""

import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from hexctl.backends.robot_options import RobotOptions
from hexctl.cli import completion
from hexctl.cli.console import (
    DONE,
    INTERRUPTED,
    StopOnInterrupt,
    code_of_stop,
    flag_of,
    note_no_window,
    print_note,
)
from hexctl.cli.options.failure import FailedLegOption, FailureOption
from hexctl.cli.options.output import NoRecordOption
from hexctl.cli.signature import with_options
from hexctl.cli.values import choice, number, rare
from hexctl.errors import EStopError, InputError
from hexctl.gait.gait import gait_text
from hexctl.gait.posture import POSTURE

if TYPE_CHECKING:
    from hexctl.control.drive.drive import Drive
    from hexctl.control.log import Recorder
    from hexctl.robot.failure import Failure
    from hexctl.serve.stop_sender import StopSender
    from hexctl.teleop.drive_page import DrivePage
    from hexctl.teleop.drive_session import Device, DriveSession
    from hexctl.wire.certificates import Credentials

#: `--page` without an address.
DEFAULT_PAGE = "127.0.0.1:8017"

DriveHold = Literal["auto", "none"]

DriveGaitOption = Annotated[
    str,
    typer.Option(
        "--gait",
        callback=gait_text,
        autocompletion=completion.gaits,
        help="Gait: demo, tripod, wave, ripple; a code, 1..720; or when in the cycle legs 1..6 step, six "
        "slots such as 5,1,2,4,3,6.",
    ),
]


@dataclass(frozen=True, slots=True)
class _Wanted:
    """What to drive with: keys, a gamepad's file or `none`, a page's address, certificates and camera.

    `terminal` is whether there are keys.
    """

    keyboard: bool
    terminal: bool
    gamepad: str | None
    page: str | None
    page_keys: Path | None
    page_view: str | None

    def check(self) -> None:
        """Raise InputError where there is nothing to drive with."""
        if self.page_keys is not None and self.page is None:
            raise InputError("--page-keys: got it without --page; allowed: with --page HOST:PORT")
        if self.page_view is not None:
            from hexctl.teleop.picture_relay import PictureRelay

            if self.page is None:
                raise InputError("--page-view: got it without --page; allowed: with --page HOST:PORT")
            PictureRelay(self.page_view)
        if self.page is not None:
            from hexctl.teleop.drive_page import PageAddress

            PageAddress.parse(self.page).check(secured=self.page_keys is not None)
        if self.pad is not None:
            from hexctl.teleop.gamepad import check_gamepad

            check_gamepad(self.pad)
        if self.keys or self.page or self.gamepad not in (None, "none"):
            return
        others = "--page HOST:PORT, or --gamepad auto"
        if not self.keyboard:
            raise InputError(f"--no-keyboard: got it with nothing else to drive with; allowed: {others}")
        raise InputError(f"--keyboard: got no terminal to read keys from; allowed: a terminal, {others}")

    @property
    def keys(self) -> bool:
        """Whether to drive with keys."""
        return self.keyboard and self.terminal

    @property
    def pad(self) -> Path | None:
        """The event file that is named."""
        return None if self.gamepad in (None, "auto", "none") else Path(str(self.gamepad))


@with_options(RobotOptions)
def drive(
    where: dict[str, Any],
    gait: DriveGaitOption = "tripod",
    body_raise: Annotated[
        float,
        rare(
            number(
                "--body-raise",
                POSTURE,
                "How much higher the body stands, as a fraction of the robot's size, {}.",
            )
        ),
    ] = 0.0,
    failed_leg: FailedLegOption = None,
    failure: FailureOption = None,
    hold: Annotated[
        DriveHold,
        choice(
            "--hold",
            DriveHold,
            "Make good what feet lose to slip, by the pose or the yaw that the robot measures (auto), or "
            "walk in open loop (none).",
        ),
    ] = "auto",
    policy: Annotated[
        str | None,
        rare(
            typer.Option(
                "--policy",
                help="What to do about a leg that is noticed to have failed: walk-on, stop, glide, or "
                "package.module:Class. (default: glide with sim, else stop)",
            )
        ),
    ] = None,
    keyboard: Annotated[
        bool, typer.Option("--keyboard/--no-keyboard", help="Drive with the keys of this terminal.")
    ] = True,
    gamepad: Annotated[
        str | None,
        typer.Option(
            "--gamepad",
            metavar="auto|none|FILE",
            autocompletion=completion.gamepads,
            help="Drive with a gamepad while a shoulder button is held: auto takes the first that is plugged "
            "in, at any time; or its event file. (default: auto)",
        ),
    ] = None,
    page: Annotated[
        str | None,
        typer.Option(
            "--page",
            metavar="HOST:PORT",
            help=f"Serve a page to drive with, such as {DEFAULT_PAGE} for this computer alone; beyond it "
            "--page-keys are needed, and the token that is printed. (default: none)",
        ),
    ] = None,
    page_keys: Annotated[
        Path | None,
        typer.Option(
            "--page-keys",
            help="Folder of certificates that hexctl keys new made, for a page beyond this computer. "
            "(default: none)",
        ),
    ] = None,
    page_view: Annotated[
        str | None,
        typer.Option(
            "--page-view",
            metavar="URL",
            help="Show on the page what a camera sees: the http or https URL of its stream or picture, such "
            "as http://127.0.0.1:8018/stream.mjpg of hexctl see. (default: none)",
        ),
    ] = None,
    view: Annotated[bool, typer.Option("--view", help="Show the drive in the Rerun viewer.")] = False,
    record: Annotated[
        Path | None,
        typer.Option(
            "--record", help="Recording to write, a new .rrd file, whose folder is made. (default: none)"
        ),
    ] = None,
    no_record: NoRecordOption = False,
) -> None:
    """Drive a robot by hand: keyboard, gamepad, or a page for a phone.

    It stands up first. q, Ctrl-C and a terminal that has gone end it with the robot at a stand. Exit codes:
    0 done, 2 bad input, 3 fault of robot or link, 4 fell or was stopped, 130 interrupted.
    """
    from hexctl.backends.registry import check_options
    from hexctl.control.drive.drive import Drive
    from hexctl.control.log import PACED_BLOCK_TICKS, Recorders
    from hexctl.robot.failure_grammar import read_failures
    from hexctl.teleop.keyboard import has_keys

    if no_record and record is not None:
        raise InputError("--no-record: got --record too; allowed: one or the other")
    wanted = _Wanted(keyboard, has_keys(), gamepad, page, page_keys, page_view)
    wanted.check()

    robot, backend = where.pop("robot"), where.pop("backend")
    options: dict[str, Any] = {name: value for name, value in where.items() if value}
    check_options(backend, **options)
    failures, events = read_failures(failure, failed_leg)
    for event in events:
        check_options(backend, names={"events": "failure"}, events=str(event))
    if backend == "sim":
        options["realtime"] = True
    with ExitStack() as stack:
        keep = stack.enter_context(_kept_once_driven(record))
        shown = _recorders(
            stack, backend, robot, where["world"], where["seed"], gait, failures, view=view, record=record
        )
        made = Drive(
            robot,
            backend=backend,
            gait=gait,
            body_raise=body_raise or None,
            policy=policy,
            hold=hold,
            failure=(*failures, *events),
            recorders=Recorders(*shown, block_ticks=PACED_BLOCK_TICKS) if shown else None,
            **options,
        )
        code = _drive(stack, made, wanted, keep)
        if record is not None:
            _say(f"hexctl: recorded in {record}; look at it with: hexctl view {shlex.quote(str(record))}")
        raise typer.Exit(code)


@contextmanager
def _kept_once_driven(record: Path | None) -> Iterator[Callable[[], None]]:
    """Removes a new recording at the end, unless what this gives was called: nothing was driven then."""
    before = record is None or record.exists()
    driven: list[bool] = []
    try:
        yield lambda: driven.append(True)
    finally:
        if record is not None and not before and not driven:
            record.unlink(missing_ok=True)


def _why(drive: "Drive", stopped: str) -> str:
    """Why the robot was stopped, in words."""
    from hexctl.cli.render.stop_reasons import why_in_words
    from hexctl.wire.links import Link

    standstill, link = drive.guard.standstill, getattr(drive.guard.unwrapped, "link", None)
    return why_in_words(
        stopped,
        None if standstill is None else standstill.duration_s,
        clear=(link if isinstance(link, Link) else Link()).clear_command,
    )


def _robot_stop(drive: "Drive") -> "StopSender | None":
    """What stops a robot on the network for all its clients; None for another backend."""
    from hexctl.wire.links import Link

    link = getattr(drive.guard.unwrapped, "link", None)
    if not isinstance(link, Link) or link.plain:
        return None
    from hexctl.serve.stop_sender import StopSender

    return StopSender(link)


def _drive(stack: ExitStack, drive: "Drive", wanted: _Wanted, keep: Callable[[], None]) -> int:
    """Connect, drive, and say how it ended; the exit code."""
    from hexctl.backends.clock import realtime_priority
    from hexctl.teleop.drive_session import DriveSession

    robot_stop = _robot_stop(drive)
    session = DriveSession(drive, robot_stop)
    interrupt = stack.enter_context(StopOnInterrupt())
    stack.enter_context(drive)
    for note in drive.notes:
        print_note(f"hexctl: {note}")
    if robot_stop is not None:
        stack.callback(_say_unconfirmed, robot_stop)
        stack.enter_context(robot_stop)
    try:
        with ExitStack() as open_devices:
            devices = _devices(open_devices, session, wanted)
            keep()
            with realtime_priority():
                why = session.run(devices, interrupt.requested)
        if interrupt.terminal_gone:
            why = "the terminal has gone"
    except EStopError:
        why = drive.guard.stopped or "stopped"
        _say(f"\nhexctl: the robot has stopped{_why(drive, why)}")
        return code_of_stop(why)
    rest = "the robot stands" if session.commanded else "the robot was not commanded"
    _say(f"\nhexctl: {'ended' if why == 'q' else why}; {rest}")
    return INTERRUPTED if why == "interrupted" else DONE


def _say_unconfirmed(robot_stop: "StopSender") -> None:
    """Report a stop that the robot has not confirmed until the end."""
    if robot_stop.trouble is not None:
        _say(f"hexctl: {robot_stop.trouble}; use hexctl estop or the switch")


def _say(text: str) -> None:
    """Print a note, on a terminal that may have gone."""
    with suppress(OSError):
        print_note(text)


def _devices(stack: ExitStack, session: "DriveSession", wanted: _Wanted) -> "list[Device]":
    """What to drive with."""
    from hexctl.teleop.gamepad import Gamepad
    from hexctl.teleop.keyboard import HELP, Keyboard, KeyTerminal

    drive, devices = session.drive, list["Device"]()
    if wanted.page is not None:
        page = stack.enter_context(_page(stack, session, wanted.page, wanted))
        devices.append(page)
        token = "" if page.token is None else f" with the token {page.token}"
        print_note(f"hexctl: drive on {page.url}{token}")
    if wanted.gamepad != "none":
        if wanted.pad is not None and not wanted.pad.exists():
            print_note(f"hexctl: no gamepad at {wanted.pad} yet; it may be plugged in at any time")
        pad = Gamepad(drive.arbiter.source("gamepad"), drive.share, session.ask, path=wanted.pad)
        stack.callback(pad.close)
        devices.append(pad)
    if wanted.keys:
        print_note(HELP)
        terminal = stack.enter_context(KeyTerminal(sys.stdin.fileno(), sys.stderr.fileno()))
        source = drive.arbiter.source("keyboard")
        devices.append(Keyboard(source, drive.share, session.ask, terminal.keys, terminal.show))
    return devices


def _page(stack: ExitStack, session: "DriveSession", address: str, wanted: _Wanted) -> "DrivePage":
    from hexctl.teleop.drive_page import DrivePage, PageAddress
    from hexctl.teleop.picture_relay import PictureRelay

    view, folder = wanted.page_view, wanted.page_keys
    return DrivePage(
        PageAddress.parse(address),
        session.drive.arbiter.source("page"),
        session.drive.share,
        session.ask,
        credentials=None if folder is None else _credentials(folder),
        pictures=None if view is None else stack.enter_context(PictureRelay(view)),
    )


def _credentials(folder: Path) -> "Credentials":
    """Certificate and key of a page; what is wrong with them is said of `--page-keys`."""
    from hexctl.wire.certificates import find_credentials
    from hexctl.wire.links import Role

    try:
        return find_credentials(folder, Role.ROBOT)
    except InputError as error:
        raise InputError(error.worded(lambda name: f"--page-{flag_of(name).removeprefix('--')}")) from error


def _recorders(
    stack: ExitStack,
    backend: str,
    robot: str,
    world: str | None,
    seed: int,
    gait: str,
    failures: "Sequence[Failure]",
    *,
    view: bool,
    record: Path | None,
) -> "list[Recorder]":
    """Live view and recording of a drive."""
    if not view and record is None:
        return []
    from hexctl.backends.sim.terrain import make_floor
    from hexctl.backends.sim.world import load_world
    from hexctl.control.trial_plan import TrialPlan
    from hexctl.gait.gait import make_gait
    from hexctl.recording.live import open_window
    from hexctl.recording.recording import Recording
    from hexctl.robot.loader import load_robot_file

    loaded = load_robot_file(robot)
    floor = make_floor(load_world("flat" if world is None else world), seed) if backend == "sim" else None
    plan = TrialPlan(
        gait=make_gait(loaded.robot, gait),
        belief=next(iter(failures), None),
        further_failures=tuple(failures[1:]),
        self_rotation="none",
        travel=0.0,
    )
    title, servos = f"{loaded.robot.name} driven", backend != "sim"
    common: dict[str, Any] = {"title": title, "floor": floor, "watched": True, "servos": servos}
    found: list[Recorder] = []
    if record is not None:
        # A drive has no planned end.
        recording = Recording(record, loaded.robot, plan, meshes=loaded.meshes, long=True, **common)
        stack.callback(recording.write_index)
        found.append(stack.enter_context(recording))
    if view and (live := open_window(note_no_window)) is not None:
        stack.enter_context(live)
        live.begin(loaded.robot, plan, looks=str(loaded.path), **common)
        found.append(live)
    return found
