"""Options that several commands of `hexctl see` have: the sheet as printed, and pictures of a camera."""

from typing import Annotated, Any

import typer

from hexctl.cli.values import number
from hexctl.options import Range

TAG = Range(low=0, high=586, whole=True)
EDGE_MM = Range(low=20, high=200, unit="mm")
FLOOR_TAGS = Range(low=0, high=20, whole=True)
FPS = Range(low=1, high=60, unit="Hz")
PORT = Range(low=0, high=65535, whole=True)
LATENCY_MS = Range(low=0, high=2000, unit="ms")


def size_of(text: str | tuple[int, int]) -> tuple[int, int]:
    """Width and height of a text such as `1280x720`; raises BadParameter for anything else."""
    if isinstance(text, tuple):
        return text
    width, cross, height = text.partition("x")
    if not (cross and width.isdecimal() and height.isdecimal() and len(text) < 20):
        raise typer.BadParameter(f"got {text}; allowed: WIDTHxHEIGHT in px, such as 1280x720")
    return int(width), int(height)


_CAMERA = "Number of a camera such as 0, its device, address of a stream (http:// or rtsp://)"

CameraOption = Annotated[
    str | None,
    typer.Option("--camera", help=f"{_CAMERA}, or a video file. (default: none, it has to be given)"),
]
LiveCameraOption = Annotated[
    str | None, typer.Option("--camera", help=f"{_CAMERA}. (default: none, it has to be given)")
]
BoardCameraOption = Annotated[
    str | None,
    typer.Option(
        "--camera",
        help=f"{_CAMERA}, or a video file, from which pictures are taken while the board is moved. "
        "(default: none, pictures are given)",
    ),
]
RobotTagOption = Annotated[
    int,
    number("--robot-tag", TAG, "Number of the robot's tag, a whole number, {}, and none of the floor's."),
]
RobotEdgeOption = Annotated[
    float, number("--robot-edge-mm", EDGE_MM, "Edge of the robot's tag in millimetres, {}.")
]
HomeEdgeOption = Annotated[
    float, number("--home-edge-mm", EDGE_MM, "Edge of the floor's tag 0 in millimetres, {}.")
]
FloorTagsOption = Annotated[
    int, number("--floor-tags", FLOOR_TAGS, "Further tags on the floor, numbered from 1, a whole number, {}.")
]
FloorEdgeOption = Annotated[float, number("--floor-edge-mm", EDGE_MM, "Edge of these in millimetres, {}.")]
SizeOption = Annotated[
    Any,
    typer.Option(
        "--size",
        parser=size_of,
        metavar="WIDTHxHEIGHT",
        help="Size of pictures in px that a camera is asked for. (default: the camera's own)",
    ),
]
FpsOption = Annotated[
    float | None,
    number("--fps", FPS, "Pictures a second that a camera is asked for, {}. (default: its own)"),
]
OneRobotOption = Annotated[
    str | None,
    typer.Option("--robot", help="Name of the robot on the link. (default: the only one there)"),
]
