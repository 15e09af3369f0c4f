"""A camera that tells a robot where it is: its options, and the place that it learns by looking."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from hexctl.errors import InputError, RobotFaultError
from hexctl.robot.loader import load_robot
from hexctl.robot.model import Robot
from hexctl.vision.camera_options import RobotCameraOptions, never
from hexctl.vision.detection.camera import Camera, place_camera
from hexctl.vision.detection.floor import averaged_corners
from hexctl.vision.detection.lens import load_lens
from hexctl.vision.detection.tags import Picture, SeenTag, TagFinder
from hexctl.vision.estimation.pose_filter import PoseEstimate
from hexctl.vision.place import Place, arena_of, load_place, save_place, store_camera
from hexctl.vision.place_setup import PlaceSetup
from hexctl.vision.pose_stream import CameraReport, CameraStatus, PoseOutputs, PoseStream
from hexctl.vision.pose_table import PoseTable
from hexctl.vision.robot_link import robot_link
from hexctl.vision.video.mjpeg import MjpegServer
from hexctl.vision.video.video_source import VideoSource
from hexctl.vision.video.video_writer import VideoWriter

#: Age of a picture of which nothing is known: of webcams 50 to 120 ms.
USUAL_LATENCY_S = 0.08

#: Pictures of which the floor is learned, and how long is waited for them.
LEARNING_PICTURES, LEARNING_S = 90, 20.0

#: Every picture of this number is searched for tags; in the others they are looked for where they were.
SEARCHED_EVERY = 15

#: Pictures by which the camera is placed at a known floor.
PLACING_PICTURES = 8


#: A camera that stands this far from where its file says, or is turned by this much, is stored again.
ELSEWHERE_M, ELSEWHERE_RAD = 0.02, math.radians(0.5)


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


@dataclass(frozen=True, kw_only=True)
class RobotCamera(RobotCameraOptions):
    """A camera over the floor that tells a robot where it is: options, checked when they are given.

        RobotCamera(camera="0", connect="tcp/127.0.0.1:7447").run(stop_requested)

    The file of the place is made by looking if it does not exist. What describes a place that is learned must
    agree with one that is known.
    """

    def run(
        self,
        stop_requested: Callable[[], bool] = never,
        *,
        on_started: Callable[[CameraStarted], None] = lambda _: None,
        on_pose: Callable[[PoseEstimate], None] = lambda _: None,
        on_status: Callable[[CameraStatus], None] = lambda _: None,
        on_event: Callable[[str], None] = lambda _: None,
    ) -> CameraReport:
        """Look until `stop_requested` returns True, or a video file ends.

        Args:
            stop_requested: asked between pictures. Where it stops the learning of a place, none is stored.
            on_started: called once, when the place is known.
            on_pose: called after each picture with where the robot is.
            on_status: called once a second.
            on_event: called with a line when camera or tags were moved, and the robot is lost or found.

        Raises InputError for files, lenses and floors that are not allowed, and RobotFaultError where camera
        or robot are not there.
        """
        before = self._before()
        with ExitStack() as opened:
            video = opened.enter_context(self.open_video(on_event))
            linked = None if self.no_link else opened.enter_context(robot_link(self.load_link(), self.robot))
            robot = load_robot(self.robot or "ant") if linked is None else linked.robot
            writer = None if self.output is None else opened.enter_context(VideoWriter(Path(self.output)))
            page = None
            if (address := self.page_address) is not None:
                page = opened.enter_context(MjpegServer(address.port, host=address.host, option="page"))
            finder = TagFinder()
            found = self._found(before, video, robot, finder, stop_requested)
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
            outputs = PoseOutputs(linked, page, writer, table)
            stream = PoseStream(place, robot, self._latency_s(place), outputs, finder)
            return stream.run(video, stop_requested, on_pose=on_pose, on_status=on_status, on_event=on_event)

    def _latency_s(self, place: Place) -> float:
        if self.latency_ms is not None:
            return self.latency_ms / 1000
        return USUAL_LATENCY_S if place.latency_s is None else place.latency_s

    def _before(self) -> Place | None:
        """The place of the file, if there is one; raises InputError for what contradicts it."""
        path = Path(self.place)
        before = load_place(path) if path.exists() else None
        if before is not None and not self.relearn:
            self._setup().check_known(before, path)
        elif self.lens is not None:
            load_lens(self.lens)  # a bad one is told before anything is opened
        return before

    def _found(
        self, before: Place | None, video: VideoSource, robot: Robot, finder: TagFinder,
        stop_requested: Callable[[], bool],
    ) -> tuple[Place, bool, tuple[str, ...]] | None:  # fmt: skip
        """The place, whether it was learned, and doubts; None where a stop was requested.

        It is that of the file, with the camera where it stands now, or learned and stored.
        """
        if before is not None and not self.relearn:
            place, changes = self._setup().measured(before)
            placed = seen_place(place, video, finder, stop_requested)
            if changes:
                save_place(place, self.place)
            if placed is not None and _stands_elsewhere(placed.camera, before.camera):
                store_camera(Path(self.place), placed.camera)
            return None if placed is None else (placed, False, changes)
        pictures = list(_searched(video, finder, LEARNING_PICTURES, stop_requested))
        if stop_requested():
            return None
        height_px, width_px = pictures[0][0].shape
        views = [averaged_corners([found for _, found in pictures])]
        place, doubts = self._setup().learned(views, (width_px, height_px), robot, before)
        save_place(place, self.place)
        return place, True, doubts

    def _setup(self) -> PlaceSetup:
        return PlaceSetup(
            lens=None if self.lens is None else Path(self.lens), fov_deg=self.fov_deg, bar_mm=self.bar_mm,
            sheet=self.printed, tag_height_mm=self.tag_height_mm,
        )  # fmt: skip


def seen_place(
    place: Place, video: VideoSource, finder: TagFinder, stop_requested: Callable[[], bool]
) -> Place | None:
    """A known place with its camera where the tags say that it stands now; None where a stop was requested.

    Raises InputError for pictures that do not fit the lens, and RobotFaultError for a video without pictures.
    """
    pictures = list(_searched(video, finder, PLACING_PICTURES, stop_requested))
    if stop_requested():
        return None
    height_px, width_px = pictures[0][0].shape
    lens = place.camera.lens.scaled(width_px, height_px)
    camera = place_camera(lens, averaged_corners([found for _, found in pictures]), place.floor_corners)
    if camera is None:
        camera = replace(place.camera, lens=lens)
    return replace(place, camera=camera)


def _stands_elsewhere(camera: Camera, known: Camera) -> bool:
    """Whether a camera shows another part of the floor than one that is known."""
    shift_m = float(np.linalg.norm(camera.position_floor - known.position_floor))
    turned_rad = Rotation.from_matrix(camera.rotation.T @ known.rotation).magnitude()
    sizes = [(each.lens.width_px, each.lens.height_px) for each in (camera, known)]
    return shift_m > ELSEWHERE_M or turned_rad > ELSEWHERE_RAD or sizes[0] != sizes[1]


def _searched(
    video: VideoSource, finder: TagFinder, count: int, stop_requested: Callable[[], bool]
) -> Iterator[tuple[Picture, dict[int, SeenTag]]]:
    """Pictures in grey with the tags in them; raises RobotFaultError where none comes."""
    given, until_s = 0, time.monotonic() + LEARNING_S
    found: dict[int, SeenTag] = {}
    while given < count and not video.ended and not stop_requested() and time.monotonic() < until_s:
        frame = video.read()
        if frame is not None:
            gray = frame.gray()
            if given % SEARCHED_EVERY == 0:
                found |= finder.search(gray, thorough=True)
            given += 1
            yield gray, finder.near(gray, {number: one.corners_px for number, one in found.items()})
    if not given and not stop_requested():
        raise RobotFaultError(f"camera {video.name} sends no pictures")


def _arena_or_none(place: Place, robot: Robot) -> tuple[tuple[float, float], float] | None:
    try:
        return arena_of(place, robot)
    except InputError:
        return None
