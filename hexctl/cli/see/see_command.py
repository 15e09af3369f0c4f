"""`hexctl see --camera`: locate a robot with a camera."""

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from hexctl.cli.output_options import JsonOption
from hexctl.cli.signature import with_options
from hexctl.vision.robot_camera import CameraStarted, RobotCamera

if TYPE_CHECKING:
    from hexctl.vision.pose_stream import CameraReport, CameraStatus


@with_options(RobotCamera)
def look(options: dict[str, Any], context: typer.Context, as_json: JsonOption = False) -> None:
    """Measure a robot's position with a camera and printed tags, and send it to the robot, until Ctrl-C.

    Options for a new place must agree with a known place, unless --relearn replaces it.
    """
    if context.invoked_subcommand is not None:
        return
    from hexctl.cli.console import StatusLine, StopOnInterrupt, print_result

    looking = RobotCamera(**options)
    with StopOnInterrupt(plain=True) as interrupt, StatusLine() as line:
        report = looking.run(
            interrupt.requested,
            on_started=lambda started: _print_started(started, options["place"]),
            on_status=lambda status: line.show(status_line(status)),
            on_event=lambda text: line.print_above(f"hexctl: {text}"),
        )
    print_result(json.dumps(report.to_dict()) if as_json else _report_line(report))


def _print_started(started: CameraStarted, path: Path) -> None:
    from hexctl.cli.console import print_note

    tags = ", ".join(map(str, sorted(started.place.floor_tags)))
    learned = "learned by looking" if started.learned else "as in the file"
    x_m, y_m, z_m = started.place.camera.position_m
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
