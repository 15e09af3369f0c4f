"""A camera that tells a robot where it is: its options, and the place that it learns by looking."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from hexctl.errors import InputError, RobotFaultError, argument
from hexctl.robot.loader import load_robot
from hexctl.robot.model import Robot
from hexctl.see.place import Place, load_place, print_scale, save_place
from hexctl.see.pose_stream import CameraStatus, PoseOutputs, PoseStream
from hexctl.see.pose_table import PoseTable
from hexctl.see.robot_link import RobotLink, robot_link
from hexctl.see.sheet import BAR_MM, Sheet
from hexctl.see.video.mjpeg import MjpegServer
from hexctl.see.video.video_source import VideoSource, open_video
from hexctl.see.video.video_writer import VideoWriter
from hexctl.see.vision.camera import place_camera
from hexctl.see.vision.floor import averaged_corners, learn_floor
from hexctl.see.vision.lens import Lens, load_lens
from hexctl.see.vision.planar_pose import PlanarPose
from hexctl.see.vision.robot_tracker import RobotTag
from hexctl.see.vision.tags import Picture, Sighted, TagFinder
from hexctl.see.vision.view import visible_circle
from hexctl.wire.links import load_link

#: Age of a picture of which nothing is known: of webcams 50 to 120 ms.
USUAL_LATENCY_S = 0.08

#: Pictures of which the floor is learned, and how long is waited for them.
LEARNING_PICTURES, LEARNING_S = 90, 20.0

#: One in so many of them is searched for tags, in the others they are looked for where they were.
SEARCHED_EVERY = 15

#: What is said where nobody has told how large the sheet was printed: no picture shows it.
BAR_DOUBT = (
    "the bar of the sheet is taken for 100 mm long: measure it; --bar-mm with another length corrects this "
    "place at any time"
)

#: Pictures by which the camera is placed anew at a known floor.
PLACING_PICTURES = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraStarted:
    """What a camera reports once it looks.

    Attributes:
        robot: name of the robot.
        place: where tags and camera are.
        learned: whether the floor was learned just now.
        doubts: what cannot be trusted of it, a sentence each.
        arena: middle (x, y) and radius in m of the largest circle in which the robot is seen, or None.
        page_url: of a page that shows what it sees, or None.
    """

    robot: str
    place: Place
    learned: bool
    doubts: tuple[str, ...]
    arena: tuple[tuple[float, float], float] | None
    page_url: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotCamera:
    """A camera over the floor: options, checked when they are given.

        RobotCamera(camera="0", connect="tcp/127.0.0.1:7447").run(stop_requested)

    Attributes:
        camera: number of a camera, its device, an address of a stream, or a video file (`open_video`).
        place: file of the place; it is made by looking where it does not exist.
        relearn: whether the tags on the floor are learned anew, in place of those of the file.
        lens: calibration of the lens (`load_lens`), for a new place; None for one that is assumed.
        fov_deg: from the left to the right edge, of a lens that is assumed.
        bar_mm: length of the sheet's bar as printed; None for that of the place, or 100 mm. A known place
            becomes larger or smaller by it.
        sheet: as it was printed, for a new place: numbers and edges of the tags.
        tag_height_mm: of the robot's tag above the origin of its base; None for the top of its trunk.
        latency_ms: age of a picture when it comes; None for that of the place, or the usual one.
        size_px: width and height that a camera is asked for; None leaves it as it is.
        fps: pictures per second that a camera is asked for; None leaves it as it is.
        linked: whether a robot is told where it is; without, legs and height are those of the robot file.
        connect: Zenoh endpoint of the robot; None is that of the link, or the default.
        credentials: folder of certificates, or None.
        insecure: whether a link beyond this computer may do without certificates.
        link: name or path of a link file, or None.
        robot: name of the robot on the link, None for the only one; without a link, a robot or its file.
        output: new video file of what was seen (.mp4 or .avi), or None.
        poses: new CSV file with the pose of each picture, or None.
        page_port: port of this computer for a page that shows what it sees, 0 for any; None for no page.
    """

    camera: str
    place: Path = Path("place.yaml")
    relearn: bool = False
    lens: Path | None = None
    fov_deg: float = 67.0
    bar_mm: float | None = None
    sheet: Sheet = field(default_factory=Sheet)
    tag_height_mm: float | None = None
    latency_ms: float | None = None
    size_px: tuple[int, int] | None = None
    fps: float | None = None
    linked: bool = True
    connect: str | None = None
    credentials: Path | None = None
    insecure: bool = False
    link: str | None = None
    robot: str | None = None
    output: Path | None = None
    poses: Path | None = None
    page_port: int | None = None

    def __post_init__(self) -> None:
        print_scale(BAR_MM if self.bar_mm is None else self.bar_mm)
        if self.latency_ms is not None and not 0 <= self.latency_ms <= 2000:
            raise InputError(f"{argument('latency_ms')}: got {self.latency_ms:g}; allowed: 0 to 2000 ms")
        for name in ("output", "poses"):
            path = getattr(self, name)
            if path is not None and path.exists():
                raise InputError(f"{argument(name)}: {path} exists; allowed: a new file, nothing is replaced")

    def run(
        self,
        stop_requested: Callable[[], bool],
        *,
        on_started: Callable[[CameraStarted], None] = lambda _: None,
        on_status: Callable[[CameraStatus], None] = lambda _: None,
        on_event: Callable[[str], None] = lambda _: None,
    ) -> dict[str, Any]:
        """Look until `stop_requested` returns True, or a video file ends; what was managed, as JSON values.

        Args:
            stop_requested: asked between pictures.
            on_started: called once, when the place is known.
            on_status: called once a second.
            on_event: called with a line when camera or tags were moved, and the robot is lost or found.

        Raises InputError for files, lenses and floors that are not allowed, and RobotFaultError where camera
        or robot are not there.
        """
        with ExitStack() as opened:
            video = opened.enter_context(
                open_video(self.camera, size_px=self.size_px, fps=self.fps, on_event=on_event)
            )
            linked = opened.enter_context(self._link()) if self.linked else None
            robot = load_robot(self.robot or "ant") if linked is None else linked.robot
            finder = TagFinder()
            place, learned, doubts = self._place(video, robot, finder, stop_requested)
            if not video.live:  # its first pictures count, too
                video = opened.enter_context(open_video(self.camera))
            shown = None
            if self.page_port is not None:
                shown = opened.enter_context(MjpegServer(self.page_port))
            writer = None if self.output is None else opened.enter_context(VideoWriter(self.output))
            table = None if self.poses is None else opened.enter_context(PoseTable(self.poses))
            on_started(
                CameraStarted(
                    robot=robot.name, place=place, learned=learned, doubts=doubts,
                    arena=_arena_or_none(place, robot), page_url=None if shown is None else shown.page_url,
                )
            )  # fmt: skip
            outputs = PoseOutputs(linked, shown, writer, table)
            stream = PoseStream(place, robot, self._latency_s(place), outputs, finder)
            return stream.run(video, stop_requested, on_status, on_event)

    @contextmanager
    def _link(self) -> Iterator[RobotLink]:
        link = load_link(
            self.link, endpoint=self.connect, credentials=self.credentials, insecure=self.insecure
        )
        with robot_link(link, self.robot) as linked:
            yield linked

    def _latency_s(self, place: Place) -> float:
        if self.latency_ms is not None:
            return self.latency_ms / 1000
        return USUAL_LATENCY_S if place.latency_s is None else place.latency_s

    def _place(
        self, video: VideoSource, robot: Robot, finder: TagFinder, stop_requested: Callable[[], bool]
    ) -> tuple[Place, bool, tuple[str, ...]]:
        """The place of the file, with the camera where it stands now, or a new one; whether it is new."""
        if self.place.exists() and not self.relearn:
            doubts = _measured_bar(self.place, self.bar_mm)
            return known_place(self.place, video, finder, stop_requested), False, doubts
        pictures = list(_searched(video, finder, LEARNING_PICTURES, stop_requested))
        size = pictures[0][0].shape[1], pictures[0][0].shape[0]
        lens = Lens.assumed(*size, self.fov_deg) if self.lens is None else load_lens(self.lens).scaled(*size)
        bar_mm = BAR_MM if self.bar_mm is None else self.bar_mm
        scale = print_scale(bar_mm)
        edges_m = {number: edge_m * scale for number, edge_m in self.sheet.floor_edges_m.items()}
        floor = learn_floor(lens, [averaged_corners([found for _, found in pictures])], edges_m)
        top_m = robot.body.size_m[2] / 2 if self.tag_height_mm is None else self.tag_height_mm / 1000
        edge_m = self.sheet.robot_edge_mm / 1000 * scale
        place = Place(
            camera=floor.cameras[0],
            floor_tags=floor.tags,
            robot_tag=RobotTag(self.sheet.robot_tag, edge_m, PlanarPose(0.0, 0.0, 0.0), top_m),
            bar_mm=bar_mm,
            lens_file=self.lens,
        )
        write_place(place, self.place)
        return place, True, (*floor.doubts, *(BAR_DOUBT,) * (self.bar_mm is None))


def _measured_bar(path: Path, bar_mm: float | None) -> tuple[str, ...]:
    """Store the length of the bar, where it was measured; what has changed by it, a sentence.

    Raises InputError for files that are not allowed.
    """
    before = load_place(path) if bar_mm is not None else None
    if before is None or bar_mm is None or bar_mm == before.bar_mm:
        return ()
    write_place(before.printed(bar_mm), path)
    percent = 100 * (bar_mm / before.bar_mm - 1)
    return (
        f"the bar of the sheet is {bar_mm:g} mm long, not {before.bar_mm:g}: "
        f"all distances change by {percent:+.1f} %",
    )


def known_place(
    path: Path, video: VideoSource, finder: TagFinder, stop_requested: Callable[[], bool]
) -> Place:
    """Place of a file, with the camera placed anew by the tags that it sees now.

    Raises InputError for files that are not allowed, and RobotFaultError for a video without pictures.
    """
    place = load_place(path)
    pictures = list(_searched(video, finder, PLACING_PICTURES, stop_requested))
    height_px, width_px = pictures[0][0].shape
    lens = place.camera.lens.scaled(width_px, height_px)
    camera = place_camera(lens, averaged_corners([found for _, found in pictures]), place.floor_corners)
    if camera is None:
        camera = replace(place.camera, lens=lens)
    return replace(place, camera=camera)


def write_place(place: Place, path: Path) -> None:
    """Write a place; raises InputError, by argument, for a file that cannot be written."""
    try:
        save_place(place, path)
    except OSError as error:
        raise InputError(f"{argument('place')}: {path} cannot be written: {error.strerror}") from error


def _searched(
    video: VideoSource, finder: TagFinder, count: int, stop_requested: Callable[[], bool]
) -> Iterator[tuple[Picture, dict[int, Sighted]]]:
    """Pictures in grey with the tags in them; raises RobotFaultError where none comes."""
    given, until_s = 0, time.monotonic() + LEARNING_S
    found: dict[int, Sighted] = {}
    while given < count and not video.ended and not stop_requested() and time.monotonic() < until_s:
        frame = video.read()
        if frame is not None:
            gray = frame.gray()
            if given % SEARCHED_EVERY == 0:
                found |= finder.search(gray, thorough=True)
            given += 1
            yield gray, finder.near(gray, {number: one.corners_px for number, one in found.items()})
    if not given:
        raise RobotFaultError(f"camera {video.name} sends no pictures")


def arena_of(place: Place, robot: Robot) -> tuple[tuple[float, float], float]:
    """Middle (x, y) and radius in m of the largest circle on the floor in which a robot is seen standing.

    Raises InputError for a camera that sees its tag nowhere.
    """
    height_m = robot.standing_height_m + place.robot_tag.height_m
    return visible_circle(place.camera, height_m, place.robot_tag.edge_m)


def _arena_or_none(place: Place, robot: Robot) -> tuple[tuple[float, float], float] | None:
    try:
        return arena_of(place, robot)
    except InputError:
        return None
