"""A camera over a robot of `hexctl serve --backend sim`: its pictures as a network camera sends them.

Light to import, without OpenCV and MuJoCo, until it runs.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np

from hexctl.backends.robot_options import SEED
from hexctl.errors import InputError, argument
from hexctl.options import RARE, Panel, Range, Typed, check_fields
from hexctl.simulators.camera.usual_camera import BLUR_PX, LOOK_AT_M, NOISE, POSITION_M
from hexctl.vision.camera_options import FPS, LATENCY_MS, LinkedRobotOptions, parse_size
from hexctl.waiting import StopRequested, never_stop

if TYPE_CHECKING:
    from hexctl.simulators.camera.shooting import TwinReport
    from hexctl.vision.detection.camera import Camera
    from hexctl.vision.detection.lens import Lens

PORT = Range(low=0, high=65535, whole=True)
NOISES = Range(low=0, high=50)
BLURS_PX = Range(low=0, high=10, unit="px")
SHARE = Range(low=0, high=1)

#: Widths and heights of pictures, in px.
SIZES_PX = (64, 4096)

#: How far from the origin a camera stands and looks at the most, in m.
MOST_M = 100.0

Point = tuple[float, float, float]


def parse_point(text: str) -> Point:
    """Coordinates in m of a text such as `-1.63,0,1.63`; raises ValueError for anything else."""
    try:
        x_m, y_m, z_m = (float(part) for part in text.split(","))
    except ValueError:
        x_m = y_m = z_m = float("nan")
    if not all(abs(one) <= MOST_M for one in (x_m, y_m, z_m)):  # false for nan too
        raise ValueError(f"got {text}; allowed: X,Y,Z in m, such as -1.63,0,1.63")
    return x_m, y_m, z_m


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
class TwinCamera(LinkedRobotOptions):
    """A rendered camera over a simulated robot: options, checked when they are given.

    TwinCamera(fps=15, latency_ms=120).run(stop_requested, on_started=print)
    """

    PANEL: ClassVar = "Camera"

    http_port: Annotated[int, PORT] = 0
    """Port of this computer for the pictures, a whole number, {}; 0: any free."""

    fps: Annotated[float, FPS, RARE] = 30.0
    """Pictures that the camera takes per second, {}; fewer if drawing is slow."""

    latency_ms: Annotated[float, LATENCY_MS, RARE] = 80.0
    """Milliseconds from what it sees to its picture's arrival, {}.

    Never less than drawing takes.
    """

    size_px: Annotated[tuple[int, int] | None, Typed(flag="size", parse=parse_size), RARE] = None
    """Size of the pictures in px, such as 640x480. (default: that of the lens, 1280x720)"""

    lens: Annotated[str | Path | None, RARE] = None
    """Calibration of its lens, a file of ROS. (default: that of a webcam)"""

    position_m: Annotated[Point, Typed(parse=parse_point), RARE] = POSITION_M
    """Where it stands: X,Y,Z in metres."""

    look_at_m: Annotated[Point, Typed(parse=parse_point), RARE] = LOOK_AT_M
    """Where it looks: X,Y,Z in metres."""

    noise: Annotated[float, NOISES, RARE, Panel("Flaws")] = NOISE
    """Standard deviation of each pixel of 0..255, a whole number or not, {}."""

    blur_px: Annotated[float, BLURS_PX, Typed(flag="blur"), RARE, Panel("Flaws")] = BLUR_PX
    """Standard deviation of the blur in px, a whole number or not, {}."""

    drop: Annotated[float, SHARE, RARE, Panel("Flaws")] = 0.0
    """Fraction of pictures that are lost, {}."""

    shadow: Annotated[float, SHARE, RARE, Panel("Flaws")] = 0.0
    """Fraction by which a wandering shadow darkens the floor, {}."""

    faults: Annotated[Sequence[str], Typed(flag="fault"), Panel("Flaws")] = ()
    """Fault of the camera, repeatable: moved:0.05,0,0@10 (m, after 10 s), turned:2@10 (degrees to the left),
    covered:2@10 (a hand covers the robot's tag for 2 s). (default: none)
    """

    seed: Annotated[int, SEED, RARE, Panel("Flaws")] = 0
    """Seed of noise and lost pictures, a whole number, {}."""

    def __post_init__(self) -> None:
        check_fields(self)
        if self.size_px is not None and not all(SIZES_PX[0] <= edge <= SIZES_PX[1] for edge in self.size_px):
            size = "x".join(map(str, self.size_px))
            raise InputError(f"{argument('size_px')}: got {size}; allowed: {SIZES_PX[0]} to {SIZES_PX[1]} px")
        if self.position_m[2] <= 0 or self.position_m == self.look_at_m:
            raise InputError(
                f"{argument('position_m')}: got {self.position_m}; allowed: above the floor, and not the "
                "point that it looks at"
            )
        if self.faults:
            from hexctl.simulators.camera.camera_faults import parse_camera_fault

            for text in self.faults:
                parse_camera_fault(text)

    def camera(self) -> "Camera":
        """Lens and position. Raises InputError for a lens that does not fit the pictures."""
        from hexctl.vision.detection.camera import Camera

        return Camera.looking(self._lens(), np.array(self.position_m), np.array(self.look_at_m))

    def _lens(self) -> "Lens":
        from hexctl.simulators.camera.rendering import FOV_DEG, WEBCAM
        from hexctl.vision.detection.lens import Lens, load_lens

        lens = WEBCAM if self.lens is None else load_lens(self.lens)
        if self.size_px is None:
            return lens
        width_px, height_px = self.size_px
        if self.lens is None and abs(height_px * lens.width_px / width_px - lens.height_px) > 1:
            return Lens.assumed(width_px, height_px, FOV_DEG)
        return lens.scaled(width_px, height_px)

    def run(
        self,
        stop_requested: StopRequested = never_stop,
        *,
        on_started: Callable[[TwinStarted], None] = lambda _: None,
        on_event: Callable[[str], None] = lambda _: None,
    ) -> "TwinReport":
        """Send pictures until `stop_requested` returns True.

        Args:
            stop_requested: called between pictures.
            on_started: called once, when clients can connect.
            on_event: called with a line when the robot falls silent or the computer is too slow.

        Raises InputError for an invalid lens or link, RobotFaultError if no simulated robot answers or the
        port is taken, and the errors of `Canvas`.
        """
        from hexctl.simulators.camera.posture_history import followed_robot
        from hexctl.simulators.camera.rendering import FLOOR_TAGS, SceneRenderer, tag_on
        from hexctl.simulators.camera.shooting import PictureFlow, Shooting
        from hexctl.vision.video.mjpeg import MjpegServer

        camera, link = self.camera(), self.load_link()
        flaws = {"noise": self.noise, "blur_px": self.blur_px, "shadow": self.shadow}
        with (
            followed_robot(link, self.robot) as (robot, history),
            SceneRenderer(robot, camera, FLOOR_TAGS, tag_on(robot), **flaws, seed=self.seed) as renderer,
            MjpegServer(self.http_port) as server,
        ):
            on_started(TwinStarted(robot=robot.name, url=server.url, page_url=server.page_url))
            flow = PictureFlow(self.fps, self.latency_ms, self.drop, tuple(self.faults), self.seed)
            shooting = Shooting(flow, renderer, tag_on(robot), history, on_event)
            return shooting.run(stop_requested, server.publish)
