"""`hexctl see`: the lens of a camera, the place that it sees, and the robot's position."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexctl.cli.console import StopOnInterrupt, print_message, print_note, print_result
from hexctl.cli.progress import StatusLine
from hexctl.cli.settings import Commands, SettingsGroup
from hexctl.cli.shared_options import JsonOption
from hexctl.cli.signature import with_options
from hexctl.vision.camera_lens import CameraLens
from hexctl.vision.robot_camera import CameraStarted, RobotCamera
from hexctl.vision.sheet import Sheet, save_sheet

if TYPE_CHECKING:
    from hexctl.vision.detection.lens_calibration import CalibratedLens, LensCalibration
    from hexctl.vision.pose_stream import CameraReport, CameraStatus

see = Commands(cls=SettingsGroup, invoke_without_command=True)


@see.callback()
@with_options(RobotCamera)
def look(options: dict[str, Any], context: typer.Context, as_json: JsonOption = False) -> None:
    """Measure a robot's position with a camera and printed tags, and send it to the robot, until Ctrl-C.

    Options for a new place must agree with a known place, unless --relearn replaces it.
    """
    if context.invoked_subcommand is not None:
        return
    looking = RobotCamera(**options)
    with StopOnInterrupt(plain=True) as interrupt, StatusLine() as line:
        report = looking.run(
            interrupt.requested,
            on_started=lambda started: _print_started(started, options["place"]),
            on_status=lambda status: line.show(_status_line(status)),
            on_event=lambda text: line.print_above(f"hexctl: {text}"),
        )
    print_result(report.to_dict() if as_json else _report_line(report))


def _print_started(started: CameraStarted, path: Path) -> None:
    tags = ", ".join(map(str, sorted(started.place.floor_tags)))
    learned = "learned by looking" if started.learned else "as in the file"
    x_m, y_m, z_m = started.place.camera.position_m
    print_note(
        f"{path}: tags {tags} on the floor, {learned}; "
        f"the camera stands at {x_m:.2f}, {y_m:.2f} m, {z_m:.2f} m high"
    )
    for doubt in started.doubts:
        print_message(doubt)
    if started.arena is not None:
        (x_m, y_m), radius_m = started.arena
        print_note(
            f"{started.robot} is seen within {radius_m:.2f} m of {x_m:.2f}, {y_m:.2f} m: adapt --arena {path}"
        )
    page = "" if started.page_url is None else f"; shown at {started.page_url}"
    print_note(f"looking for {started.robot}{page}; Ctrl-C ends it")


def _status_line(status: "CameraStatus") -> str:
    """Line of a second: position of the robot, its source, and its visibility."""
    tag = f", {status.tag_px:.0f} px, quality {status.quality:.2f}" if status.seen else ""
    pictures = f"{status.fps:.0f} pictures a second, tag in {status.seen:.0%}{tag}"
    pose = status.estimate.pose
    if pose is None:
        return f"pose not known; {pictures}"
    where = f"{pose.x_m:+.3f}, {pose.y_m:+.3f} m, {math.degrees(pose.yaw_rad):+.1f} deg"
    return f"{where}; {status.estimate.sight}; {pictures}"


def _report_line(report: "CameraReport") -> str:
    if report.look_s is None:
        return "ended before the robot was looked for"
    return (
        f"{report.pictures} pictures in {report.duration_s:.1f} s, the robot in {report.seen:.0%} of "
        f"them; {1000 * report.look_s:.1f} ms of processor time each"
    )


@see.command("print")
@with_options(Sheet, rare=("robot_edge_mm", "home_edge_mm", "floor_edge_mm"))
def print_(
    sheet: dict[str, Any],
    output: Annotated[
        Path,
        typer.Option("--output", "-o", help="New PDF file; nothing is replaced."),
    ] = Path("sheet.pdf"),
) -> None:
    """Make a PDF with the tags of robot and floor, and a board to calibrate the lens with."""
    save_sheet(Sheet(**sheet), output)
    print_result(f"{output}")


@see.command()
@with_options(CameraLens)
def calibrate(
    options: dict[str, Any],
    pictures: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="PICTURE",
            help="Pictures of the board on the last page of the sheet. (default: those of --camera)",
            show_default=False,
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Calibrate the lens of a camera by pictures of the printed board.

    Show the board to the camera at all edges of the picture, tilted and near; hold it still for a moment each
    time. Ctrl-C ends it and uses the pictures so far.
    """
    calibration = CameraLens(**options, pictures=pictures or ())
    with StopOnInterrupt(plain=True) as interrupt:
        result = calibration.run(interrupt.requested, on_view=_print_kept, on_event=print_message)
    for sentence in result.missing:
        print_note(f"to make it better: {sentence}")
    output = options["output"]
    print_result(_lens_json(result, output) if as_json else _lens_text(result, output))


def _print_kept(calibration: "LensCalibration") -> None:
    print_note(f"{calibration.pictures} pictures; {'; '.join(calibration.missing()) or 'that is enough'}")


def _lens_json(result: "CalibratedLens", output: Path) -> dict[str, object]:
    return {
        "lens": str(output),
        "pictures": result.pictures,
        "rms_px": round(result.rms_px, 3),
        "doubt_px": round(result.doubt_px, 3),
        "coverage": round(result.coverage, 2),
        "missing": list(result.missing),
    }


def _lens_text(result: "CalibratedLens", output: Path) -> str:
    return (
        f"{output}: {result.pictures} pictures, which cover {result.coverage:.0%} of the picture; it misses "
        f"the board by {result.rms_px:.2f} px, rays by about {result.doubt_px:.1f} px"
    )
