"""`hexctl export`: robots, recordings and sessions in the formats of other programs."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from hexctl.cli import completion
from hexctl.cli.console import make_bar, print_result
from hexctl.cli.options.robot import ROBOTS, robot_option
from hexctl.cli.progress import WithBar
from hexctl.cli.results.skipped_recordings import LeftOut
from hexctl.cli.settings import runs_folder
from hexctl.cli.values import choice, number, with_values
from hexctl.options import Range

if TYPE_CHECKING:
    from hexctl.robot.model import Robot

Format = Literal["urdf", "mjcf", "mcap", "csv", "parquet", "lerobot", "gif", "mp4"]
Camera = Literal["side", "top", "follow"]

WIDTH_PX = Range(low=64, high=1920, whole=True, unit="pixels")
FPS = Range(low=1, high=50, unit="per second")
SECOND_S = Range(low=0, high=86_400, unit="s")
LENGTH_S = Range(low=0, high=86_400, above=True, unit="s")


def export(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="ROBOT|RECORDING|SESSION...",
            autocompletion=completion.exportable,
            help=f"A robot ({ROBOTS}, or a YAML file), recordings (.rrd), or the name of a "
            "session. Two recordings race in a GIF or MP4; several make one LeRobot dataset.",
        ),
    ],
    to: Annotated[
        Format | None,
        choice(
            "--to",
            Format,
            "Of a robot urdf or mjcf; of recordings mcap (ROS 2, Foxglove), csv, parquet, lerobot, gif or "
            "mp4; of a session csv, parquet, lerobot or mcap. (default: by the ending of --output)",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="New file, or new folder for mcap and lerobot; nothing is replaced, its folder is made. "
            "(default: named after the source)",
        ),
    ] = None,
    robot: Annotated[
        str | None, robot_option("that of the recording", use="For recordings without one.")
    ] = None,
    ros2_control: Annotated[
        bool,
        typer.Option(
            "--ros2-control", help="Add a block to a URDF with which ros2_control commands the joints."
        ),
    ] = False,
    camera: Annotated[
        Camera | None,
        choice(
            "--camera",
            Camera,
            "Of a GIF or MP4: side, top or follow; of a race side or top. (default: follow, of a race side)",
        ),
    ] = None,
    width: Annotated[
        int | None,
        number("--width", WIDTH_PX, "Width of a GIF or MP4, a whole number of pixels, {}. (default: 480)"),
    ] = None,
    fps: Annotated[
        float | None,
        number("--fps", FPS, "Pictures in each second of it, {}. (default: 20 in a GIF, 50 in an MP4)"),
    ] = None,
    begin: Annotated[
        float | None,
        number("--from", SECOND_S, "Second of the recording at which it begins, {}. (default: 0)"),
    ] = None,
    duration: Annotated[
        float | None,
        number("--duration", LENGTH_S, "Seconds of the recording that it shows, {}. (default: all)"),
    ] = None,
    caption: Annotated[
        list[str] | None,
        typer.Option(
            "--caption",
            help="Line below a run, or the name of each in a race. (default: gait and failure in a race)",
        ),
    ] = None,
) -> None:
    """Write a robot, recordings or a session in a format of other programs.

    A recording of a session that is missing or damaged is named on stderr, with exit code 3; the others are
    written all the same.
    """
    from hexctl.export.export import export as write

    picture = with_values(
        camera=camera,
        width_px=width,
        fps=fps,
        from_s=begin,
        duration_s=duration,
        captions=None if caption is None else tuple(caption),
    )
    left_out = LeftOut()
    with _Progress() as progress:
        path = write(
            *sources,
            to=to,
            output=output,
            robot=_robot(robot),
            ros2_control=ros2_control,
            folder=runs_folder(),
            on_progress=progress.tell,
            on_damage=left_out.name,
            **picture,
        )
    print_result(f"{path}")
    raise typer.Exit(left_out.code())


class _Progress(WithBar):
    """A bar on stderr while there is more to do, on a terminal."""

    def __init__(self) -> None:
        self._bar = make_bar()
        self._task = self._bar.add_task("written (Ctrl-C stops)", total=None, visible=False)

    def tell(self, done: int, total: int) -> None:
        """Show how much is done."""
        self._bar.update(self._task, completed=done, total=total, visible=total > 1)


def _robot(name: str | None) -> "Robot | None":
    from hexctl.robot.loader import load_robot

    return None if name is None else load_robot(name)
