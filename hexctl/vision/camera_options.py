"""Options that cameras share: which robot on which link, and which camera over which place.

Light to import, without OpenCV: the help of `hexctl see` needs only these.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from hexctl.errors import InputError, argument
from hexctl.files import check_new
from hexctl.options import RARE, Range, Typed, check_fields
from hexctl.wire.links import Link, LinkOptions, load_link

if TYPE_CHECKING:
    from hexctl.vision.video.videos import VideoSource

FPS = Range(low=1, high=60, unit="Hz")
LATENCY_MS = Range(low=0, high=2000, unit="ms")


def parse_size(text: str) -> tuple[int, int]:
    """Width and height in px of a text such as `1280x720`; raises ValueError for anything else."""
    width, cross, height = text.partition("x")
    if not (cross and width.isdecimal() and height.isdecimal() and len(text) < 20):
        raise ValueError(f"got {text}; allowed: WIDTHxHEIGHT in px, such as 1280x720")
    return int(width), int(height)


def check_new_file(name: str, path: str | Path) -> None:
    """Raise InputError for a file that exists or whose folder is missing; `name` is its option."""
    check_new(Path(path), argument(name))
    check_folder(name, path)


def check_folder(name: str, path: str | Path) -> None:
    """Raise InputError for a file whose folder is missing; `name` is its option."""
    if not Path(path).parent.is_dir():
        raise InputError(f"{argument(name)}: got {path}; allowed: an existing folder")


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkedRobotOptions(LinkOptions):
    """Which robot on a link."""

    robot: str | None = None
    """Name of the robot on the link. (default: the only one there)"""

    def load_link(self) -> Link:
        """The link; raises InputError for an invalid one."""
        credentials = None if self.credentials is None else Path(self.credentials)
        return load_link(self.link, connect=self.connect, credentials=credentials, insecure=self.insecure)


# Without slots: a class has one base with slots, and cameras with a robot have those of the link.
@dataclass(frozen=True, kw_only=True)
class VideoOptions:
    """The camera and its requested picture size and rate."""

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
        from hexctl.vision.video.videos import open_video

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
