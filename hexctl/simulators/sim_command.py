"""`hexctl sim`: simulated servo boards, servo buses and a camera; and legs that fail and heal in mid-walk."""

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexctl.cli.console import StopOnInterrupt, print_message, print_note, print_result
from hexctl.cli.settings import Commands, runs_folder
from hexctl.cli.shared_options import JsonOption
from hexctl.cli.signature import checked, with_options
from hexctl.robot.failure_grammar import parse_leg
from hexctl.simulators.board_service import BoardService
from hexctl.simulators.camera.twin_camera import TwinCamera
from hexctl.wire.links import LinkOptions, Role, load_link

if TYPE_CHECKING:
    from hexctl.client.remote import RemoteRobots
    from hexctl.server.service import ServiceStarted
    from hexctl.simulators.camera.shooting import TwinReport
    from hexctl.simulators.camera.twin_camera import TwinStarted
    from hexctl.vision.detection.lens import Lens

sim = Commands()


@sim.command()
@with_options(BoardService, but=("link",), rare=("world", "failed_leg", "pty"))
def board(asked: dict[str, Any], as_json: JsonOption = False) -> None:
    """Simulate a servo board that speaks MAVLink 2, or servos on a bus.

    It runs until Ctrl-C. hexctl run --backend mavlink walks its simulated robot, and hexctl run --backend
    feetech --port PORT that behind servos on a bus.
    """
    bus = asked["bus"]
    service = BoardService(**asked)

    def on_started(started: "ServiceStarted") -> None:
        robot = f"{started.robot} ({started.backend})"
        if bus is None:
            guarded = "signed frames only" if service.signed else "not signed"
            print_note(f"board of {robot} at {started.place}, {guarded}; Ctrl-C ends it")
        else:
            line = started.place + (f", {service.bits_per_s} baud" if service.bits_per_s else "")
            print_note(f"bus of {robot} with {bus} servos at {line}; Ctrl-C ends it")

    with StopOnInterrupt() as interrupt:
        report = service.run(interrupt.requested, on_started=on_started)
    if as_json:
        print_result(report)


@sim.command()
@with_options(TwinCamera)
def camera(options: dict[str, Any], as_json: JsonOption = False) -> None:
    """Simulate a network camera that looks at the robot of hexctl serve --backend sim, until Ctrl-C.

    Its pictures are drawn by MuJoCo, with tag 10 on the robot (edge 10 cm) and tags 0 to 3 on the floor, and
    have the flaws of a real camera. hexctl see --camera URL takes them like those of any other. Its lens is
    written under runs/, as if it had been calibrated.
    """
    service = TwinCamera(**options)

    def on_started(started: "TwinStarted") -> None:
        print_note(
            f"camera over {started.robot} at {started.url} (in a browser {started.page_url}); Ctrl-C ends it"
        )
        lens_file = options["lens"] or _written(service.camera().lens)
        print_note(f"look  hexctl see --camera {started.url} --lens {shlex.quote(str(lens_file))}")

    with StopOnInterrupt(plain=True) as interrupt:
        report = service.run(interrupt.requested, on_started=on_started, on_event=print_message)
    print_result(report.to_dict() if as_json else _pictures_line(report))


def _written(lens: "Lens") -> Path:
    from hexctl.vision.detection.lens import save_lens

    file = runs_folder() / "sim-camera-lens.yaml"
    file.parent.mkdir(parents=True, exist_ok=True)
    save_lens(lens, file)
    return file


def _pictures_line(report: "TwinReport") -> str:
    arrived = (
        "none of which arrived"
        if report.latency_s is None
        else f"{1000 * report.latency_s:.0f} ms old at their arrival"
    )
    return f"{report.fps:.1f} pictures a second, {arrived}; {report.skipped} not drawn, {report.late} late"


@sim.command()
@with_options(LinkOptions)
def fail(
    place: dict[str, Any],
    failure: Annotated[
        str,
        typer.Argument(
            metavar="LEG:KIND",
            help="Which leg, and how: 5:locked, 5:limp, 5:limp:femur, 5:missing, 5:weak:0.3, 5:stuck:femur "
            "(jams where it is).",
            show_default=False,
        ),
    ],
    as_json: JsonOption = False,
) -> None:
    """Let a leg of a simulated robot fail now; its walk has to detect that.

    The walk stops then, or changes gait if it was begun with --recover.
    """
    _change(lambda robots: robots.fail(failure), place, as_json=as_json)


@sim.command()
@with_options(LinkOptions)
def heal(
    place: dict[str, Any],
    leg: Annotated[
        int,
        typer.Argument(
            parser=checked(parse_leg), metavar="LEG", help="Which leg that failed, 1..6.", show_default=False
        ),
    ],
    as_json: JsonOption = False,
) -> None:
    """Let a leg of a simulated robot work again."""
    _change(lambda robots: robots.heal(leg), place, as_json=as_json)


def _change(
    change: "Callable[[RemoteRobots], list[dict[str, Any]]]",
    place: dict[str, Any],
    *,
    as_json: bool,
) -> None:
    from hexctl.client.remote import remote_robots

    with remote_robots(load_link(**place), Role.CONTROLLER) as robots:
        answers = change(robots)
    failures = [str(failure) for answer in answers for failure in answer["failures"]]
    for note in sorted({str(answer["note"]) for answer in answers if "note" in answer}):
        print_message(note)
    if as_json:
        print_result({"failures": failures, "robots": answers})
    else:
        print_result(f"failed now: {', '.join(failures) or 'none'}")
