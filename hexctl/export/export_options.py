"""Options of an export: format, output, and pictures."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_args

from hexctl.control.trial_plan import DURATION_S
from hexctl.options import RARE, Range, Typed, check_fields
from hexctl.robot.model import Robot

RobotFormat = Literal["urdf", "mjcf", "ros2"]
TrialFormat = Literal["mcap", "csv", "parquet", "lerobot", "gif", "mp4"]
Format = Literal[RobotFormat, TrialFormat]
Camera = Literal["side", "top", "follow"]

ROBOT_FORMATS, TRIAL_FORMATS = get_args(RobotFormat), get_args(TrialFormat)
FORMATS = get_args(Format)

WIDTH_PX = Range(low=64, high=1920, whole=True, unit="pixels")
FPS = Range(low=1, high=50, unit="per second")
SECOND_S = Range(low=0, high=86_400, unit="s")


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureOptions:
    """Options of GIF and MP4."""

    PANEL: ClassVar = "GIF and MP4"

    camera: Camera | None = None
    """Camera of a GIF or MP4: side, top or follow; of a race side or top. (default: follow, of a race side)
    """

    width_px: Annotated[int | None, WIDTH_PX, Typed(flag="width"), RARE] = None
    """Width of a GIF or MP4, a whole number of pixels, {}. (default: 480)"""

    fps: Annotated[float | None, FPS, RARE] = None
    """Pictures per second, {}. (default: 20 in a GIF, 50 in an MP4)"""

    from_s: Annotated[float | None, SECOND_S] = None
    """Start at this second of the walk, {}. (default: start of the recording)"""

    duration_s: Annotated[float | None, DURATION_S] = None
    """Seconds of the recording that it shows, {}. (default: all)"""

    captions: Annotated[Sequence[str], Typed(flag="caption"), RARE] = ()
    """Name of each run, in its line of text, repeatable. (default: gait and failure)"""

    def __post_init__(self) -> None:
        check_fields(self)
        object.__setattr__(self, "captions", tuple(self.captions))

    @property
    def given(self) -> dict[str, Any]:
        """Given options of pictures, by field."""
        values = {field.name: getattr(self, field.name) for field in fields(PictureOptions)}
        return {name: value for name, value in values.items() if value not in (None, ())}


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportOptions(PictureOptions):
    """Source robot, format and output of an export."""

    PANEL: ClassVar = "Format"

    to: Format | None = None
    """Format: of a robot urdf, mjcf or ros2 (launch file, layouts of RViz and Foxglove); of recordings mcap
    (ROS 2, Foxglove), csv, parquet, lerobot, gif or mp4; of a session csv, parquet, lerobot or mcap.
    (default: by the ending of --output)
    """

    output: Annotated[str | Path | None, Typed(short="o")] = None
    """New file, or new folder for mcap, lerobot and ros2; nothing is replaced, its folder is made. (default:
    named after the source)
    """

    robot: Annotated[str | Path | Robot | None, Typed(words="robots"), RARE] = None
    """Robot of recordings without one: a shipped name or a YAML file. (default: that of the recording)

    In Python also a Robot.
    """

    ros2_control: Annotated[bool, RARE] = False
    """Add a block to a URDF with which ros2_control commands the joints."""
