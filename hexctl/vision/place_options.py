"""Options by which a place is learned, or compared with a known one. Importing it does not load OpenCV."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from hexctl.options import RARE, Panel, Range, Typed
from hexctl.vision.camera_options import LATENCY_MS, CameraOptions, check_folder
from hexctl.vision.sheet import BAR_LENGTH_MM, EDGE_MM, FLOOR_TAGS, TAG, Sheet

FOV_DEG = Range(low=10, high=150, unit="deg")
HEIGHT_MM = Range(low=-500, high=1000, unit="mm")


@dataclass(frozen=True, kw_only=True)
class PlaceOptions(CameraOptions):
    """Which camera, and the tags and the lens of a new place; a known place must agree with them."""

    camera: Annotated[str | int | Path | None, Typed(parse=str)] = None
    """Camera: its number such as 0, its device, the address of a stream (http:// or rtsp://), or a video
    file. (default: none, required)
    """

    place: str | Path = Path("place.yaml")
    """YAML file with the floor's tags and the camera; made by looking if it is missing."""

    relearn: bool = False
    """Learn the tags on the floor again, in place of the file's."""

    lens: str | Path | None = None
    """Calibration of the lens, for a new place. (default: that of the place, else one without distortion, of
    --fov-deg)
    """

    fov_deg: Annotated[float | None, FOV_DEG, Typed(flag="fov-deg"), RARE] = None
    """Degrees from the left to the right edge, without a calibration, for a new place, {}. (default: those of
    the place, else 67)
    """

    bar_mm: Annotated[float | None, BAR_LENGTH_MM, RARE] = None
    """Millimetres that the bar of the sheet measures, {}; scales the place. (default: that of the place, else
    100)
    """

    robot_tag: Annotated[int | None, TAG, RARE] = None
    """Number of the robot's tag, a whole number, {}, and none of the floor's. (default: that of the place,
    else 10)
    """

    robot_edge_mm: Annotated[float | None, EDGE_MM, RARE] = None
    """Edge of the robot's tag in millimetres, {}. (default: that of the place, else 100)"""

    home_edge_mm: Annotated[float | None, EDGE_MM, RARE] = None
    """Edge of the floor's tag 0 in millimetres, {}. (default: that of the place, else 110)"""

    floor_tags: Annotated[int | None, FLOOR_TAGS, RARE] = None
    """Further tags on the floor, numbered from 1, a whole number, {}. (default: those of the place, else
    3)
    """

    floor_edge_mm: Annotated[float | None, EDGE_MM, RARE] = None
    """Edge of further tags in millimetres, {}. (default: that of the place, else 160)"""

    tag_height_mm: Annotated[float | None, HEIGHT_MM, RARE] = None
    """Millimetres of the robot's tag above the origin of its body, for a new place, {}. (default: those of
    the place, else the top of its trunk)
    """

    latency_ms: Annotated[float | None, LATENCY_MS, RARE, Panel("Camera")] = None
    """Milliseconds from what the camera sees to its picture's arrival, {}. (default: those of the place, else
    80)
    """

    def __post_init__(self) -> None:
        CameraOptions.__post_init__(self)
        _ = self.sheet
        check_folder("place", self.place)

    @property
    def sheet(self) -> Sheet:
        """The printed sheet, with the given values; raises InputError for one that cannot be."""
        names = ("robot_tag", "robot_edge_mm", "home_edge_mm", "floor_tags", "floor_edge_mm")
        return Sheet(**{name: value for name in names if (value := getattr(self, name)) is not None})
