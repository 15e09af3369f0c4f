"""`hexctl see --camera`: a camera tells a robot where it is."""

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexctl.cli.options.output import JsonOption
from hexctl.cli.see.see_options import (
    LATENCY_MS,
    PORT,
    CameraOption,
    FloorEdgeOption,
    FloorTagsOption,
    FpsOption,
    HomeEdgeOption,
    RobotEdgeOption,
    RobotTagOption,
    SizeOption,
)
from hexctl.cli.signature import with_options
from hexctl.cli.values import is_said, number
from hexctl.options import Range
from hexctl.wire.links import LinkOptions

if TYPE_CHECKING:
    from hexctl.vision.pose_stream import CameraReport, CameraStatus
    from hexctl.vision.robot_camera import CameraStarted

FOV_DEG = Range(low=10, high=150, unit="deg")
BAR_MM = Range(low=50, high=200, unit="mm")
HEIGHT_MM = Range(low=-500, high=1000, unit="mm")


@with_options(LinkOptions)
def look(
    link: dict[str, Any],
    context: typer.Context,
    camera: CameraOption = None,
    place: Annotated[
        Path,
        typer.Option(
            "--place",
            help="YAML file with the floor's tags and the camera; made by looking where it is not there.",
        ),
    ] = Path("place.yaml"),
    relearn: Annotated[
        bool, typer.Option("--relearn", help="Learn the tags on the floor again, in place of the file's.")
    ] = False,
    lens: Annotated[
        Path | None,
        typer.Option(
            "--lens",
            help="Calibration of the lens, for a new place. (default: that of the place, else one without "
            "distortion, of --fov-deg)",
        ),
    ] = None,
    fov_deg: Annotated[
        float | None,
        number(
            "--fov-deg",
            FOV_DEG,
            "Degrees from the left to the right edge, without a calibration, for a new place, {}. (default: "
            "those of the place, else 67)",
        ),
    ] = None,
    bar_mm: Annotated[
        float | None,
        number(
            "--bar-mm",
            BAR_MM,
            "Millimetres that the bar of the sheet measures, {}; the place becomes larger or smaller by it. "
            "(default: what the place says, else 100)",
        ),
    ] = None,
    robot_tag: RobotTagOption = 10,
    robot_edge_mm: RobotEdgeOption = 100.0,
    home_edge_mm: HomeEdgeOption = 110.0,
    floor_tags: FloorTagsOption = 3,
    floor_edge_mm: FloorEdgeOption = 160.0,
    tag_height_mm: Annotated[
        float | None,
        number(
            "--tag-height-mm",
            HEIGHT_MM,
            "Millimetres of the robot's tag above the origin of its body, for a new place, {}. (default: "
            "those of the place, else the top of its trunk)",
        ),
    ] = None,
    latency_ms: Annotated[
        float | None,
        number(
            "--latency-ms",
            LATENCY_MS,
            "Milliseconds from what the camera sees to its picture's arrival, {}. (default: those of the "
            "place, else 80)",
        ),
    ] = None,
    size: SizeOption = None,
    fps: FpsOption = None,
    robot: Annotated[
        str | None,
        typer.Option(
            "--robot",
            help="Name of the robot on the link, with --no-link a robot or its file. (default: the only one "
            "on the link, or ant)",
        ),
    ] = None,
    no_link: Annotated[
        bool, typer.Option("--no-link", help="Tell no robot where it is, only page, video and table.")
    ] = False,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="New video of what is seen, .mp4 or .avi. (default: none)"),
    ] = None,
    poses: Annotated[
        Path | None,
        typer.Option("--poses", help="New CSV file with the pose of each picture. (default: none)"),
    ] = None,
    page: Annotated[
        float | None,
        number(
            "--page",
            PORT,
            "Port of this computer for a page that shows what is seen, a whole number, {}; 0: any free. "
            "(default: no page)",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Find a robot on the floor with a camera and printed tags, and tell it where it is, until Ctrl-C.

    What is for a new place must agree with a place that is known; with --relearn it takes its place, and what
    is not given stays.
    """
    if context.invoked_subcommand is not None:
        return
    from hexctl.cli.console import StatusLine, StopOnInterrupt, print_result
    from hexctl.errors import InputError
    from hexctl.vision.robot_camera import RobotCamera

    if camera is None:
        raise InputError("--camera: got none; allowed: a number such as 0, an address, or a video file")
    printed = {
        "robot_tag": int(robot_tag),
        "robot_edge_mm": robot_edge_mm,
        "home_edge_mm": home_edge_mm,
        "floor_tags": int(floor_tags),
        "floor_edge_mm": floor_edge_mm,
    }
    looking = RobotCamera(
        camera=camera,
        place=place,
        relearn=relearn,
        lens=lens,
        fov_deg=fov_deg,
        bar_mm=bar_mm,
        sheet={name: value for name, value in printed.items() if is_said(context, name)} or None,
        tag_height_mm=tag_height_mm,
        latency_ms=latency_ms,
        size_px=size,
        fps=fps,
        linked=not no_link,
        **link,
        robot=robot,
        output=output,
        poses=poses,
        page_port=None if page is None else int(page),
    )
    with StopOnInterrupt(plain=True) as interrupt, StatusLine() as line:
        report = looking.run(
            interrupt.requested,
            on_started=lambda started: _print_started(started, place),
            on_status=lambda status: line.show(status_line(status)),
            on_event=lambda text: line.print_above(f"hexctl: {text}"),
        )
    print_result(json.dumps(report.to_dict()) if as_json else _report_line(report))


def _print_started(started: "CameraStarted", path: Path) -> None:
    from hexctl.cli.console import print_note

    tags = ", ".join(map(str, sorted(started.place.floor_tags)))
    learned = "learned by looking" if started.learned else "as the file says"
    x_m, y_m, z_m = started.place.camera.position_floor
    print_note(
        f"{path}: tags {tags} on the floor, {learned}; "
        f"the camera stands at {x_m:.2f}, {y_m:.2f} m, {z_m:.2f} m high"
    )
    for doubt in started.doubts:
        print_note(f"hexctl: {doubt}")
    if started.arena is not None:
        (x_m, y_m), radius_m = started.arena
        print_note(
            f"{started.robot} is seen within {radius_m:.2f} m of {x_m:.2f}, {y_m:.2f} m: adapt --arena {path}"
        )
    page = "" if started.page_url is None else f"; shown at {started.page_url}"
    print_note(f"looking for {started.robot}{page}; Ctrl-C ends it")


def status_line(status: "CameraStatus") -> str:
    """Line of a second: where the robot is, by what, and how it is seen."""
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
