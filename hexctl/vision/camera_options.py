"""Options of cameras: which robot on which link, which camera over which place, and what is shown.

Light to import, without OpenCV: the help of `hexctl see` needs only these.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from hexctl.errors import InputError, argument
from hexctl.options import RARE, UNTYPED, Panel, Range, Typed, check_fields
from hexctl.vision.sheet import BAR_LENGTH_MM, EDGE_MM, FLOOR_TAGS, TAG, Sheet
from hexctl.wire.links import Link, LinkOptions, link_of
from hexctl.wire.page_address import PageAddress

if TYPE_CHECKING:
    from hexctl.vision.video.video_source import VideoSource

FPS = Range(low=1, high=60, unit="Hz")
LATENCY_MS = Range(low=0, high=2000, unit="ms")
FOV_DEG = Range(low=10, high=150, unit="deg")
HEIGHT_MM = Range(low=-500, high=1000, unit="mm")


def never() -> bool:
    """Whether to stop, for a call that nothing stops early."""
    return False


def parse_size(text: str) -> tuple[int, int]:
    """Width and height in px of a text such as `1280x720`; raises ValueError for anything else."""
    width, cross, height = text.partition("x")
    if not (cross and width.isdecimal() and height.isdecimal() and len(text) < 20):
        raise ValueError(f"got {text}; allowed: WIDTHxHEIGHT in px, such as 1280x720")
    return int(width), int(height)


def check_new_file(name: str, path: str | Path) -> None:
    """Raise InputError for a file that exists or whose folder is missing; `name` is its option."""
    if Path(path).exists():
        raise InputError(f"{argument(name)}: {path} exists; allowed: a new file, nothing is replaced")
    check_folder(name, path)


def check_folder(name: str, path: str | Path) -> None:
    """Raise InputError for a file whose folder is missing; `name` is its option."""
    if not Path(path).parent.is_dir():
        raise InputError(f"{argument(name)}: got {path}; allowed: a folder that is there")


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkedRobotOptions(LinkOptions):
    """Which robot on a link."""

    robot: str | None = None
    """Name of the robot on the link. (default: the only one there)"""

    def __post_init__(self) -> None:
        check_fields(self)

    def load_link(self) -> Link:
        """The link; raises InputError for one that is not allowed."""
        credentials = None if self.credentials is None else Path(self.credentials)
        return link_of(connect=self.connect, credentials=credentials, insecure=self.insecure, link=self.link)


# Without slots: a class has one base with slots, and cameras with a robot have those of the link.
@dataclass(frozen=True, kw_only=True)
class VideoOptions:
    """Which camera, and what it is asked for."""

    PANEL: ClassVar = "Camera"

    camera: Annotated[str | int | Path | None, Typed(parse=str)] = None
    """Camera: its number such as 0, its device, or the address of a stream (http:// or rtsp://). (default:
    none, required)
    """

    size_px: Annotated[tuple[int, int] | None, Typed(flag="size", parse=parse_size), RARE] = None
    """Size of pictures in px to ask a camera for, such as 1280x720. (default: the camera's own)"""

    fps: Annotated[float | None, FPS, RARE] = None
    """Pictures per second to ask a camera for, {}. (default: the camera's own)"""

    def open_video(self, on_event: Callable[[str], None] = lambda _: None) -> "VideoSource":
        """Pictures of the camera, to be closed; for events and errors see `open_video` of the video room."""
        from hexctl.vision.video.video_source import open_video

        return open_video(str(self.camera), size_px=self.size_px, fps=self.fps, on_event=on_event)


@dataclass(frozen=True, kw_only=True)
class CameraOptions(VideoOptions, LinkedRobotOptions):
    """Which camera, over which place, and for which robot."""

    PANEL: ClassVar = "Place"

    place: str | Path = Path("place.yaml")
    """YAML file with the floor's tags and the camera, which hexctl see --camera makes."""

    def __post_init__(self) -> None:
        if self.camera is None:
            raise InputError(
                f"{argument('camera')}: got none; allowed: a number such as 0, a device, or an address"
            )
        check_fields(self)


@dataclass(frozen=True, kw_only=True)
class RobotCameraOptions(CameraOptions):
    """How a camera looks at a robot, and what is known of a new place."""

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

    robot: str | None = None
    """Name of the robot on the link; with --no-link a robot or its file. (default: the only one on the link,
    or ant)
    """

    no_link: Annotated[bool, RARE, Panel("Connection")] = False
    """Send no robot its pose; only page, video and table."""

    page: Annotated[str | int | None, Panel("Output")] = None
    """Serve a page that shows what the camera sees: HOST:PORT, or a port of 127.0.0.1; 0 takes a free port.
    (default: no page)

    Only this computer reaches it.
    """

    output: Annotated[str | Path | None, Typed(short="o"), Panel("Output")] = None
    """New video of what is seen, .mp4 or .avi. (default: none)"""

    poses: Annotated[str | Path | None, RARE, Panel("Output")] = None
    """New CSV file with the pose of each picture. (default: none)"""

    def __post_init__(self) -> None:
        CameraOptions.__post_init__(self)
        Sheet(**self.printed)
        _ = self.page_address
        for name in ("output", "poses"):
            if (path := getattr(self, name)) is not None:
                check_new_file(name, path)
        check_folder("place", self.place)

    @property
    def printed(self) -> Mapping[str, Any]:
        """What is given of the sheet, by the names of the fields of `Sheet`."""
        names = ("robot_tag", "robot_edge_mm", "home_edge_mm", "floor_tags", "floor_edge_mm")
        return {name: value for name in names if (value := getattr(self, name)) is not None}

    @property
    def page_address(self) -> PageAddress | None:
        """Where the page is served; raises InputError for an address that other computers reach."""
        if self.page is None:
            return None
        address = PageAddress.parse(str(self.page))
        if not address.loopback:
            raise InputError(
                f"{argument('page')}: got {address.host}, which other computers reach; allowed: 127.0.0.1 or "
                "localhost"
            )
        return address


@dataclass(frozen=True, kw_only=True)
class LensOptions(VideoOptions):
    """How a lens is calibrated by the printed board."""

    pictures: Annotated[Sequence[str | Path], UNTYPED] = ()
    """Files of pictures of the board; none with a camera."""

    camera: Annotated[str | int | Path | None, Typed(parse=str)] = None
    """Camera that films the board while it is moved: its number such as 0, its device, an address, or a video
    file. (default: none, pictures are given)
    """

    output: Annotated[str | Path, Typed(short="o")] = Path("lens.yaml")
    """New YAML file, as ROS's camera_info; nothing is replaced."""

    fisheye: Annotated[bool, RARE] = False
    """Calibrate a lens that sees more than about 110 degrees."""

    def __post_init__(self) -> None:
        check_fields(self)
        camera = argument("camera")
        if bool(self.pictures) == (self.camera is not None):
            raise InputError(
                f"calibrate: got pictures and {camera}, or neither; allowed: pictures, or {camera}"
            )
        for name in ("size_px", "fps"):
            if self.pictures and getattr(self, name) is not None:
                raise InputError(f"{argument(name)}: got one with pictures; allowed: with {camera}")
        check_new_file("output", self.output)
