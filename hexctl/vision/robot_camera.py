"""The camera command: its options, and the run that opens camera, robot and outputs and sends poses.

Importing it does not load OpenCV.
"""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from hexctl.errors import InputError, argument
from hexctl.options import RARE, Panel, Typed
from hexctl.vision.camera_options import check_new_file
from hexctl.vision.place_options import PlaceOptions
from hexctl.waiting import StopRequested, never_stop
from hexctl.wire.page_address import PageAddress

if TYPE_CHECKING:
    from hexctl.robot.model import Robot
    from hexctl.vision.estimation.pose_filter import PoseEstimate
    from hexctl.vision.place import Place
    from hexctl.vision.pose_stream import CameraReport, CameraStatus


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraStarted:
    """Report of a started camera.

    Attributes:
        robot: name of the robot.
        place: tags and camera.
        learned: whether the floor was learned now.
        doubts: reasons not to trust the place, one sentence each.
        arena: middle (x, y) and radius in m of the largest circle where the robot is visible, or None.
        page_url: address of the page with the pictures, or None.
    """

    robot: str
    place: "Place"
    learned: bool
    doubts: tuple[str, ...]
    arena: tuple[tuple[float, float], float] | None
    page_url: str | None


@dataclass(frozen=True, kw_only=True)
class RobotCamera(PlaceOptions):
    """Locate a robot with a camera over the floor and send it its pose.

        RobotCamera(camera="0", connect="tcp/127.0.0.1:7447").run(stop_requested)

    If the place file does not exist, the place is learned first. Options that describe a new place must agree
    with a known one.
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
        PlaceOptions.__post_init__(self)
        _ = self.page_address
        for name in ("output", "poses"):
            if (path := getattr(self, name)) is not None:
                check_new_file(name, path)

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

    def run(
        self,
        stop_requested: StopRequested = never_stop,
        *,
        on_started: Callable[[CameraStarted], None] = lambda _: None,
        on_pose: "Callable[[PoseEstimate], None]" = lambda _: None,
        on_status: "Callable[[CameraStatus], None]" = lambda _: None,
        on_event: Callable[[str], None] = lambda _: None,
    ) -> "CameraReport":
        """Run until `stop_requested` returns True or a video file ends.

        Args:
            stop_requested: called between pictures. A stop while a place is learned stores nothing.
            on_started: called once, when the place is known.
            on_pose: called after each picture with the pose.
            on_status: called once a second.
            on_event: called with a line when camera or tags were moved, or the robot is lost or found.

        Raises InputError for invalid files, lenses and floors, and RobotFaultError if camera or robot are
        missing.
        """
        from hexctl.robot.loader import load_robot
        from hexctl.vision.detection.tags import TagFinder
        from hexctl.vision.observer import Observer
        from hexctl.vision.place_learning import camera_place, known_place
        from hexctl.vision.pose_stream import CameraReport, PoseStream, PoseTable
        from hexctl.vision.robot_link import robot_link
        from hexctl.vision.video.mjpeg import MjpegServer
        from hexctl.vision.video.videos import VideoWriter

        before = known_place(self)
        with ExitStack() as opened:
            video = opened.enter_context(self.open_video(on_event))
            linked = None if self.no_link else opened.enter_context(robot_link(self.load_link(), self.robot))
            robot = load_robot(self.robot or "ant") if linked is None else linked.robot
            writer = None if self.output is None else opened.enter_context(VideoWriter(Path(self.output)))
            page = None
            if (address := self.page_address) is not None:
                page = opened.enter_context(MjpegServer(address.port, host=address.host, option="page"))
            finder = TagFinder()
            found = camera_place(self, before, video, robot, finder, stop_requested)
            if found is None:
                return CameraReport()
            place, learned, doubts = found
            if not video.live:  # its first pictures count, too
                video = opened.enter_context(self.open_video())
            table = None if self.poses is None else opened.enter_context(PoseTable(Path(self.poses)))
            on_started(
                CameraStarted(
                    robot=robot.name, place=place, learned=learned, doubts=doubts,
                    arena=_arena_or_none(place, robot), page_url=None if page is None else page.page_url,
                )
            )  # fmt: skip
            latency_s = place.picture_age_s if self.latency_ms is None else self.latency_ms / 1000
            camera, corners = place.viewpoint, place.floor_corners
            observer = Observer(robot, camera, corners, place.tag, finder=finder, latency_s=latency_s)
            stream = PoseStream(observer, robot=linked, page=page, video=writer, table=table)
            return stream.run(video, stop_requested, on_pose=on_pose, on_status=on_status, on_event=on_event)


def _arena_or_none(place: "Place", robot: "Robot") -> tuple[tuple[float, float], float] | None:
    from hexctl.vision.place import arena_of

    try:
        return arena_of(place, robot)
    except InputError:
        return None
