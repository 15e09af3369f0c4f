"""Options of a rendered camera; light to import, without OpenCV and MuJoCo."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from hexctl.backends.robot_options import SEED
from hexctl.errors import InputError, argument
from hexctl.options import RARE, Panel, Range, Typed, check_fields
from hexctl.vision.camera_options import FPS, LATENCY_MS, LinkedRobotOptions, parse_size

PORT = Range(low=0, high=65535, whole=True)
NOISE = Range(low=0, high=50)
BLUR_PX = Range(low=0, high=10, unit="px")
SHARE = Range(low=0, high=1)

#: Widths and heights of pictures, in px.
SIZES_PX = (64, 4096)

#: How far from the origin a camera stands and looks at the most, in m.
MOST_M = 100.0

Point = tuple[float, float, float]

#: Position of the camera and the point that it looks at, in m.
POSITION_M, LOOK_AT_M = (-1.63, 0.0, 1.63), (0.0, 0.0, 0.0)


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
class TwinOptions(LinkedRobotOptions):
    """Pose of a rendered camera over a simulated robot, and the flaws of its pictures."""

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

    noise: Annotated[float, NOISE, RARE, Panel("Flaws")] = 4.0
    """Standard deviation of each pixel of 0..255, a whole number or not, {}."""

    blur_px: Annotated[float, BLUR_PX, Typed(flag="blur"), RARE, Panel("Flaws")] = 0.7
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
