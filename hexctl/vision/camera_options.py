"""Options that cameras share: which robot on which link, and which camera over which place."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import NoneType

from hexctl.errors import check_type
from hexctl.vision.video.video_source import VideoSource, open_video
from hexctl.wire.links import Link, load_link

#: Ages of pictures that are allowed, in ms.
LATENCIES_MS = (0.0, 2000.0)


def never() -> bool:
    """Whether to stop, for a call that nothing stops early."""
    return False


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkOptions:
    """Which robot, and where it is.

    Attributes:
        connect: Zenoh endpoint of the robot; None is that of the link, or the default.
        credentials: folder of certificates, or None.
        insecure: whether a link beyond this computer may do without certificates.
        link: name or path of a link file, or None.
        robot: name of the robot on the link, None for the only one there.
    """

    connect: str | None = None
    credentials: str | Path | None = None
    insecure: bool = False
    link: str | None = None
    robot: str | None = None

    def __post_init__(self) -> None:
        for name in ("connect", "link", "robot"):
            check_type(getattr(self, name), (str, NoneType), name)
        check_type(self.credentials, (str, Path, NoneType), "credentials")

    def load_link(self) -> Link:
        """The link; raises InputError for one that is not allowed."""
        credentials = None if self.credentials is None else Path(self.credentials)
        return load_link(self.link, endpoint=self.connect, credentials=credentials, insecure=self.insecure)


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraOptions(LinkOptions):
    """Which camera, and over which place; the robot is that of `LinkOptions`.

    Attributes:
        camera: number of a camera, its device, an address of a stream, or a video file.
        place: file of the place.
        size_px: width and height that a camera is asked for; None leaves it as it is.
        fps: pictures per second that a camera is asked for; None leaves it as it is.
    """

    camera: str | int | Path
    place: str | Path = Path("place.yaml")
    size_px: tuple[int, int] | None = None
    fps: float | None = None

    def __post_init__(self) -> None:
        LinkOptions.__post_init__(self)
        check_type(self.camera, (str, int, Path), "camera", "a number, a device, an address or a file")
        check_type(self.place, (str, Path), "place")

    def open_video(self, on_event: Callable[[str], None] = lambda _: None) -> VideoSource:
        """Pictures of the camera, to be closed; for events and errors see `hexctl.vision.open_video`."""
        return open_video(str(self.camera), size_px=self.size_px, fps=self.fps, on_event=on_event)
