"""Draw tags, floor, robot and its path into the picture."""

import math
from collections import deque
from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from hexctl.types import FloatArray
from hexctl.vision.detection.camera import Camera
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.detection.robot_tracker import SeenRobot
from hexctl.vision.detection.tags import Picture

#: Colours, blue first as OpenCV has them.
_SEEN, _BELIEVED, _FLOOR, _TEXT = (80, 220, 80), (60, 160, 255), (230, 180, 60), (255, 255, 255)
_GRID, _DARK = (175, 175, 175), (40, 40, 40)

#: Size of the text in small pictures, below which it cannot be read.
LEAST_FONT = 0.4

#: Length of the arrow that shows the robot's heading, and of the axes at the home tag, in m.
ARROW_M, AXIS_M = 0.25, 0.2

#: Points of the path to draw.
PATH_POINTS = 600

#: Distance between the lines on the floor, and how far they reach, in m.
_GRID_M, _REACH_M = 0.5, 2.0


class Overlay:
    """Draws into one picture after the other, and remembers the way of the robot."""

    def __init__(self) -> None:
        self._path: deque[tuple[float, float]] = deque(maxlen=PATH_POINTS)

    def draw(
        self,
        picture: Picture,
        camera: Camera,
        floor_corners: Mapping[int, FloatArray],
        *,
        sighting: SeenRobot | None,
        pose_floor: PlanarPose | None,
        height_m: float,
        lines: Sequence[str],
    ) -> Picture:
        """Copy of a picture, (H, W, 3) with blue first, with what was seen in it.

        Corners of the tags on the floor are (4, 2) in m, by number. The pose is the believed one of the
        robot, the height that of its tag above the floor. The lines go into the upper left corner.
        """
        drawn = picture.copy()
        self._floor(drawn, camera, floor_corners)
        if sighting is not None:
            _polygon(drawn, sighting.tag.corners_px, _SEEN, 2)
        if pose_floor is None:
            self._path.append((math.nan, math.nan))  # interrupts the way
        else:
            self._path.append((pose_floor.x_m, pose_floor.y_m))
            self._robot(drawn, camera, pose_floor, height_m)
        _text(drawn, lines)
        return np.asarray(drawn)

    def _floor(self, drawn: Picture, camera: Camera, floor_corners: Mapping[int, FloatArray]) -> None:
        steps = np.arange(-_REACH_M, _REACH_M + _GRID_M / 2, _GRID_M)
        along = np.linspace(-_REACH_M, _REACH_M, 41)
        for step in steps:
            across = np.full_like(along, step)
            for line in (np.column_stack([along, across]), np.column_stack([across, along])):
                _path(drawn, camera.pixels_in_view(_at_height(line, 0.0)), _GRID, 1)
        for number, corners in floor_corners.items():
            corners_px = camera.pixels(_at_height(corners, 0.0))
            _polygon(drawn, corners_px, _FLOOR, 2)
            _name(drawn, f"{number}", corners_px[corners_px[:, 1].argmax()], _FLOOR)
        axes = np.array([[0.0, 0.0], [AXIS_M, 0.0], [0.0, AXIS_M]])
        origin, x_axis, y_axis = camera.pixels(_at_height(axes, 0.0))
        _arrow(drawn, origin, x_axis, (60, 60, 230))
        _arrow(drawn, origin, y_axis, (60, 200, 60))
        _name(drawn, "x", x_axis, (60, 60, 230))
        _name(drawn, "y", y_axis, (60, 200, 60))

    def _robot(self, drawn: Picture, camera: Camera, pose: PlanarPose, height_m: float) -> None:
        way = camera.pixels(_at_height(np.array(self._path), height_m))
        _path(drawn, way, _BELIEVED, 2)
        ends = pose.of_points(np.array([[0.0, 0.0], [ARROW_M, 0.0]]))
        middle, tip = camera.pixels(_at_height(ends, height_m))
        _arrow(drawn, middle, tip, _BELIEVED)


def _text(drawn: Picture, lines: Sequence[str]) -> None:
    size = _font_size(drawn)
    (_, height), below = cv2.getTextSize("Ty", cv2.FONT_HERSHEY_SIMPLEX, size, 1)  # of every line
    for row, line in enumerate(lines):
        (width, _), _ = cv2.getTextSize(line, cv2.FONT_HERSHEY_SIMPLEX, size, 1)
        bottom = 10 + (row + 1) * (height + below + 4)
        cv2.rectangle(drawn, (6, bottom - height - 4), (14 + width, bottom + below), _DARK, cv2.FILLED)
        cv2.putText(drawn, line, (10, bottom), cv2.FONT_HERSHEY_SIMPLEX, size, _TEXT, 1, cv2.LINE_AA)


def _name(drawn: Picture, text: str, beside_px: FloatArray, color: tuple[int, int, int]) -> None:
    """Draw a short text right of and below a point, unless it is far outside the picture."""
    if np.isfinite(beside_px).all() and np.abs(beside_px).max() < 4 * max(drawn.shape[:2]):
        size = 1.6 * _font_size(drawn)
        at = (round(float(beside_px[0]) + 20 * size), round(float(beside_px[1]) + 40 * size))
        for shade, width in ((_DARK, 3), (color, 1)):
            cv2.putText(drawn, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, shade, width, cv2.LINE_AA)


def _font_size(drawn: Picture) -> float:
    return max(LEAST_FONT, float(drawn.shape[0]) / 1200)


def _at_height(points: FloatArray, height_m: float) -> FloatArray:
    return np.column_stack([points, np.full(len(points), height_m)])


def _polygon(drawn: Picture, corners_px: FloatArray, color: tuple[int, int, int], thickness: int) -> None:
    _path(drawn, np.concatenate([corners_px, corners_px[:1]]), color, thickness)


def _path(drawn: Picture, points_px: FloatArray, color: tuple[int, int, int], thickness: int) -> None:
    """Draw a line through points; invisible points interrupt it."""
    # OpenCV draws to a sixteenth of a pixel, and far outside of the picture its numbers overflow.
    size = max(drawn.shape[:2])
    near = (np.abs(points_px) < 4 * size).all(axis=1)  # False for NaN too
    for start, end in zip(
        points_px[:-1][near[:-1] & near[1:]], points_px[1:][near[:-1] & near[1:]], strict=True
    ):
        cv2.line(drawn, _fixed(start), _fixed(end), color, thickness, cv2.LINE_AA, shift=4)


def _arrow(drawn: Picture, start: FloatArray, end: FloatArray, color: tuple[int, int, int]) -> None:
    if np.isfinite([start, end]).all() and np.abs([start, end]).max() < 4 * max(drawn.shape[:2]):
        cv2.arrowedLine(drawn, _fixed(start), _fixed(end), color, 2, cv2.LINE_AA, shift=4, tipLength=0.25)


def _fixed(point: FloatArray) -> tuple[int, int]:
    return round(16 * float(point[0])), round(16 * float(point[1]))
