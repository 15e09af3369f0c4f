"""Draw tags, the axes of the floor and the robot into the picture."""

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
_X, _Y, _DARK = (60, 60, 230), (60, 200, 60), (40, 40, 40)

#: Size of the text in small pictures, below which it cannot be read.
LEAST_FONT = 0.4

#: Length of the arrow that shows the robot's heading, and of the axes at the home tag, in m.
ARROW_M, AXIS_M = 0.25, 0.2


def with_overlay(
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

    Corners of the tags on the floor are (4, 2) in m, by number. The pose is the believed one of the robot,
    the height that of its tag above the floor. The lines go into the upper left corner.
    """
    drawn = picture.copy()
    for number, corners in floor_corners.items():
        corners_px = camera.pixels(_at_height(corners, 0.0))
        _polygon(drawn, corners_px, _FLOOR)
        _name(drawn, f"{number}", corners_px[corners_px[:, 1].argmax()], _FLOOR)
    axes = np.array([[0.0, 0.0], [AXIS_M, 0.0], [0.0, AXIS_M]])
    origin, x_axis, y_axis = camera.pixels(_at_height(axes, 0.0))
    for name, end, color in (("x", x_axis, _X), ("y", y_axis, _Y)):
        _arrow(drawn, np.array([origin, end]), color)
        _name(drawn, name, end, color)
    if sighting is not None:
        _polygon(drawn, sighting.tag.corners_px, _SEEN)
    if pose_floor is not None:
        ends = pose_floor.of_points(np.array([[0.0, 0.0], [ARROW_M, 0.0]]))
        _arrow(drawn, camera.pixels(_at_height(ends, height_m)), _BELIEVED)
    _text(drawn, lines)
    return np.asarray(drawn)


def _text(drawn: Picture, lines: Sequence[str]) -> None:
    size = _font_size(drawn)
    (_, height), below = cv2.getTextSize("Ty", cv2.FONT_HERSHEY_SIMPLEX, size, 1)  # of every line
    for row, line in enumerate(lines):
        (width, _), _ = cv2.getTextSize(line, cv2.FONT_HERSHEY_SIMPLEX, size, 1)
        bottom = 10 + (row + 1) * (height + below + 4)
        cv2.rectangle(drawn, (6, bottom - height - 4), (14 + width, bottom + below), _DARK, cv2.FILLED)
        cv2.putText(drawn, line, (10, bottom), cv2.FONT_HERSHEY_SIMPLEX, size, _TEXT, 1, cv2.LINE_AA)


def _name(drawn: Picture, text: str, beside_px: FloatArray, color: tuple[int, int, int]) -> None:
    """Draw a short text right of and below a point."""
    if _near(drawn, beside_px):
        size = 1.6 * _font_size(drawn)
        at = (round(float(beside_px[0]) + 20 * size), round(float(beside_px[1]) + 40 * size))
        for shade, width in ((_DARK, 3), (color, 1)):
            cv2.putText(drawn, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, shade, width, cv2.LINE_AA)


def _font_size(drawn: Picture) -> float:
    return max(LEAST_FONT, float(drawn.shape[0]) / 1200)


def _at_height(points: FloatArray, height_m: float) -> FloatArray:
    return np.column_stack([points, np.full(len(points), height_m)])


def _near(drawn: Picture, points_px: FloatArray) -> bool:
    """Whether points are in or near the picture: far outside of it, OpenCV's numbers overflow."""
    return bool((np.abs(points_px) < 4 * max(drawn.shape[:2])).all())  # False for NaN too


def _polygon(drawn: Picture, corners_px: FloatArray, color: tuple[int, int, int]) -> None:
    if _near(drawn, corners_px):
        points = np.rint(16 * corners_px).astype(np.int32)  # drawn to a sixteenth of a pixel
        cv2.polylines(drawn, [points], True, color, 2, cv2.LINE_AA, shift=4)


def _arrow(drawn: Picture, ends_px: FloatArray, color: tuple[int, int, int]) -> None:
    if _near(drawn, ends_px):
        start, end = np.rint(16 * ends_px).astype(int).tolist()
        cv2.arrowedLine(drawn, start, end, color, 2, cv2.LINE_AA, shift=4, tipLength=0.25)
