"""A camera over a robot of `hexctl serve --backend sim`: its pictures as a network camera sends them."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import cv2
import numpy as np

from hexctl.options import UNTYPED
from hexctl.robot.model import Robot
from hexctl.vision.detection.camera import Camera
from hexctl.vision.detection.lens import Lens, load_lens
from hexctl.vision.detection.planar_pose import PlacedTag, PlanarPose
from hexctl.vision.detection.tags import Picture
from hexctl.vision.twin.camera_faults import CameraFaults, parse_camera_fault, with_hand
from hexctl.vision.twin.delivery import Delivery, TakenPicture
from hexctl.vision.twin.posture_history import PostureHistory, followed_robot
from hexctl.vision.twin.rendering import CameraFlaws, RobotPosture, SceneRenderer
from hexctl.vision.twin.twin_options import LOOK_AT_M, POSITION_M, TwinOptions
from hexctl.vision.video.mjpeg import MjpegServer
from hexctl.waiting import StopRequested, never

#: Number of the robot's tag and its edge.
ROBOT_TAG, ROBOT_EDGE_M = 10, 0.1

#: A webcam whose lens bends lines at the edge by 20 px.
WEBCAM = Lens(
    width_px=1280,
    height_px=720,
    matrix=np.array([[960.0, 0, 652], [0, 955, 349], [0, 0, 1]]),
    distortion=np.array([-0.28, 0.09, 5e-4, -3e-4, -0.01]),
)

#: Field of view of a webcam with pictures of another shape, whose lens bends nothing.
FOV_DEG = 67.0

CAMERA = Camera.looking(WEBCAM, np.array(POSITION_M), np.array(LOOK_AT_M))

#: Tags on the floor by number, as large as `hexctl see print` makes them.
FLOOR_TAGS = {
    number: PlacedTag(number, edge_m, PlanarPose(*pose))
    for number, (edge_m, *pose) in enumerate(
        [(0.11, 0.0, 0.9, 0.3), (0.16, 0.2, -0.95, 1.0), (0.16, 0.9, 0.1, 2.0), (0.16, -0.6, 0.0, 0.0)]
    )
}


def tag_on(robot: Robot, edge_m: float = ROBOT_EDGE_M) -> PlacedTag:
    """Tag in the middle of a robot's trunk, on top of it."""
    return PlacedTag(ROBOT_TAG, edge_m, PlanarPose(0, 0, 0), robot.body.size_m[2] / 2 + 0.001)


#: The posture at a moment is known once the next state has come: a control period and what the link takes.
SETTLE_S = 0.023

#: Longest wait between two questions whether to stop.
POLL_S = 0.05

#: When the frame rate is checked, and the share of the requested rate below which a warning is printed.
JUDGED_AFTER_S, LEAST_SHARE = 5.0, 0.9

#: Time without a true pose after which the robot counts as silent.
SILENT_S = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class TwinStarted:
    """Report of a started rendered camera.

    Attributes:
        robot: name of the robot.
        url: address of the stream.
        page_url: address of the page that shows it.
    """

    robot: str
    url: str
    page_url: str


@dataclass(frozen=True, slots=True, kw_only=True)
class TwinReport:
    """Statistics of a rendered camera.

    Attributes:
        duration_s: total time.
        drawn: number of rendered pictures.
        delivered: number of delivered pictures.
        dropped: number of pictures dropped on request.
        skipped: number of pictures skipped for lack of time.
        late: number of pictures delivered too late.
        latency_s: mean time from exposure to delivery; None without delivery.
        drawing_s: recent time to render a picture.
        developing_s: recent time to process and encode a picture.
    """

    duration_s: float
    drawn: int
    delivered: int
    dropped: int
    skipped: int
    late: int
    latency_s: float | None
    drawing_s: float
    developing_s: float

    @property
    def fps(self) -> float:
        """Pictures drawn per second."""
        return self.drawn / self.duration_s if self.duration_s > 0 else 0.0

    def to_dict(self) -> dict[str, Any]:
        """JSON values, rounded."""
        return {
            "duration_s": round(self.duration_s, 1),
            "fps": round(self.fps, 1),
            "drawn": self.drawn,
            "delivered": self.delivered,
            "dropped": self.dropped,
            "skipped": self.skipped,
            "late": self.late,
            "latency_ms": None if self.latency_s is None else round(1000 * self.latency_s, 1),
            "drawing_ms": round(1000 * self.drawing_s, 1),
            "developing_ms": round(1000 * self.developing_s, 1),
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class TwinCamera(TwinOptions):
    """A rendered camera over a simulated robot: options, checked when they are given.

    TwinCamera(fps=15, latency_ms=120).run(stop_requested, on_started=print)
    """

    floor_tags: Annotated[Mapping[int, PlacedTag], UNTYPED] = field(default_factory=lambda: FLOOR_TAGS)
    """Tags on the floor, by number."""

    def __post_init__(self) -> None:
        TwinOptions.__post_init__(self)
        for text in self.faults:
            parse_camera_fault(text)

    def camera(self) -> Camera:
        """Lens and position. Raises InputError for a lens that does not fit the pictures."""
        return Camera.looking(self._lens(), np.array(self.position_m), np.array(self.look_at_m))

    def _lens(self) -> Lens:
        lens = WEBCAM if self.lens is None else load_lens(self.lens)
        if self.size_px is None:
            return lens
        width_px, height_px = self.size_px
        if self.lens is None and abs(height_px * lens.width_px / width_px - lens.height_px) > 1:
            return Lens.assumed(width_px, height_px, FOV_DEG)
        return lens.scaled(width_px, height_px)

    def run(
        self,
        stop_requested: StopRequested = never,
        *,
        on_started: Callable[[TwinStarted], None] = lambda _: None,
        on_event: Callable[[str], None] = lambda _: None,
    ) -> TwinReport:
        """Send pictures until `stop_requested` returns True.

        Args:
            stop_requested: called between pictures.
            on_started: called once, when clients can connect.
            on_event: called with a line when the robot falls silent or the computer is too slow.

        Raises InputError for an invalid lens or link, RobotFaultError if no simulated robot answers or the
        port is taken, and the errors of `Canvas`.
        """
        camera, link = self.camera(), self.load_link()
        flaws = CameraFlaws(noise=self.noise, blur_px=self.blur_px, shadow=self.shadow)
        with (
            followed_robot(link, self.robot) as (robot, history),
            SceneRenderer(robot, camera, self.floor_tags, tag_on(robot), flaws, seed=self.seed) as renderer,
            MjpegServer(self.http_port) as server,
        ):
            on_started(TwinStarted(robot=robot.name, url=server.url, page_url=server.page_url))
            shooting = _Shooting(self, _Scene(self, robot, camera, renderer), history, on_event)
            return shooting.run(stop_requested, server.publish)


class _Scene:
    """What the camera sees, faults included."""

    def __init__(self, options: TwinCamera, robot: Robot, camera: Camera, renderer: SceneRenderer) -> None:
        self._still, self._renderer, self._tag = camera, renderer, tag_on(robot)
        self._faults = CameraFaults(tuple(map(parse_camera_fault, options.faults)))

    def take(self, posture: RobotPosture, at_s: float) -> Callable[[], Picture]:
        """Take a picture at a time since the start; return a function that processes it to (H, W, 3), BGR."""
        camera = self._faults.camera(self._still, at_s)
        if camera != self._renderer.camera:
            self._renderer.move_camera(camera)
        exposed = self._renderer.expose(posture)

        def develop() -> Picture:
            picture = self._renderer.develop(exposed, at_s)
            if self._faults.cover(at_s):
                picture = with_hand(picture, camera, posture, self._tag)
            return np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))

        return develop


class _Shooting:
    """Takes pictures at a constant rate, or as often as the computer manages in time."""

    def __init__(
        self, options: TwinCamera, scene: _Scene, history: PostureHistory, on_event: Callable[[str], None]
    ) -> None:
        self._options, self._scene, self._history, self._on_event = options, scene, history, on_event
        self._random = np.random.default_rng(options.seed)
        self._drawing_s = 0.03
        self._drawn = self._dropped = self._skipped = 0
        self._silent = self._told = False

    def run(self, stop_requested: Callable[[], bool], publish: Callable[[bytes], None]) -> TwinReport:
        delivery = Delivery(publish)
        started_s = time.monotonic()
        try:
            self._shoot(stop_requested, started_s, delivery)
        finally:
            delivery.close()
        return self._report(delivery, time.monotonic() - started_s)

    def _shoot(self, stop_requested: Callable[[], bool], started_s: float, delivery: Delivery) -> None:
        period_s, number = 1 / self._options.fps, 0
        while not stop_requested():
            now_s = time.monotonic()
            self._judge(now_s, now_s - started_s, delivery)
            newest = int((now_s - SETTLE_S - started_s) / period_s)
            known_s = started_s + number * period_s + SETTLE_S
            if newest < number or now_s < known_s:
                time.sleep(min(POLL_S, max(0.0, known_s - now_s) + 1e-4))
                continue
            taken_at_s = started_s + newest * period_s
            self._skipped += newest - number
            number = newest + 1
            due_at_s = taken_at_s + max(self._options.latency_ms / 1000, SETTLE_S + self._cost_s(delivery))
            if now_s + self._cost_s(delivery) > due_at_s + Delivery.LATE_S:
                self._skipped += 1  # the next moment can be drawn in time
                continue
            posture = self._history.at(taken_at_s)
            if posture is None:
                raise AssertionError("a posture was waited for")
            develop = self._scene.take(posture, taken_at_s - started_s)
            self._drawn += 1
            self._drawing_s += 0.2 * (time.monotonic() - now_s - self._drawing_s)
            if self._random.random() < self._options.drop:
                self._dropped += 1
            else:
                delivery.send(TakenPicture(develop, taken_at_s, due_at_s))

    def _cost_s(self, delivery: Delivery) -> float:
        return self._drawing_s + delivery.developing_s

    def _judge(self, now_s: float, since_start_s: float, delivery: Delivery) -> None:
        """Report when the robot falls silent, and once if the computer is too slow."""
        silent = now_s - (self._history.newest_at_s or now_s) > SILENT_S
        if silent != self._silent:
            self._silent = silent
            self._on_event(
                "the robot is silent; the picture shows its last pose" if silent else "the robot is back"
            )
        if self._told or since_start_s < JUDGED_AFTER_S:
            return
        self._told = True
        managed_fps = self._drawn / since_start_s
        least_ms = 1000 * (SETTLE_S + self._cost_s(delivery))
        if managed_fps < LEAST_SHARE * self._options.fps:
            self._on_event(
                f"this computer draws {managed_fps:.1f} of {self._options.fps:g} pictures a second in time"
            )
        if least_ms > self._options.latency_ms + 1000 * Delivery.LATE_S:
            self._on_event(f"pictures are {least_ms:.0f} ms late, as drawing takes that long")

    def _report(self, delivery: Delivery, duration_s: float) -> TwinReport:
        return TwinReport(
            duration_s=duration_s,
            drawn=self._drawn,
            delivered=delivery.delivered,
            dropped=self._dropped,
            skipped=self._skipped,
            late=delivery.late,
            latency_s=delivery.latency_s / delivery.delivered if delivery.delivered else None,
            drawing_s=self._drawing_s,
            developing_s=delivery.developing_s,
        )
