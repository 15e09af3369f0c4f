"""Find the robot's tag in a picture: first near its expected place, then anywhere."""

from dataclasses import dataclass

import numpy as np

from hexctl.robot.rotations import levelled
from hexctl.types import ArrayFields, FloatArray
from hexctl.vision.detection.camera import Camera
from hexctl.vision.detection.planar_pose import PlacedTag, PlanarFit, PlanarPose, fitted_pose
from hexctl.vision.detection.tags import Picture, SeenTag, TagFinder

#: Initial and minimum standard deviation of a corner's coordinate in px: noise, blur, remaining distortion.
CORNER_PX = 0.25

#: Weight of the initial value, in pictures, and length of the memory.
FIRST_PICTURES, MOST_PICTURES = 1.0, 20.0

#: Degrees of freedom: eight coordinates minus position, rotation and size of the square.
_FREE = 4


#: A tag whose edge looks longer or shorter than printed by more than this share is at another height, or is
#: another tag.
EDGE_SHARE = 0.15

#: Standard deviation of the position that no number of pixels improves: of height and camera, in m.
FLOOR_M = 0.002

#: A body that does not lean.
LEVEL = np.array([0.0, 0.0, 1.0])

#: Pictures without the tag between two searches of the whole picture, of which every third is thorough.
SEARCH_EVERY, THOROUGH_EVERY = 3, 3


@dataclass(frozen=True, slots=True, eq=False)
class SeenRobot(ArrayFields):
    """A robot as seen in one picture.

    Attributes:
        pose_floor: of the robot's base.
        covariance: (3, 3) of x, y in m and yaw in rad.
        tag: as it was seen.
        quality: 0 to 1, by the size of the tag, its contrast and how square it looks.
    """

    pose_floor: PlanarPose
    covariance: FloatArray
    tag: SeenTag
    quality: float


class RobotTracker:
    """Finds the tag of a robot in one picture after the other."""

    def __init__(self, tag: PlacedTag, finder: TagFinder) -> None:
        self.tag, self._finder = tag, finder
        self._last_px: FloatArray | None = None
        self._missed = 0
        self._variance_px2, self._pictures = CORNER_PX**2, FIRST_PICTURES

    def find(
        self,
        gray: Picture,
        camera: Camera,
        base_height_m: float,
        expected: PlanarPose | None = None,
        up_body: FloatArray = LEVEL,
    ) -> SeenRobot | None:
        """The robot in a grey picture (H, W), or None.

        The base of the robot is at a height above the floor. The tag leans with the robot: `up_body` is the
        vertical in the body frame.
        """
        corners = levelled(self.tag.corners_body, up_body) + np.array([0.0, 0.0, base_height_m])
        seen_tag = self._tag_at(gray, camera, corners, expected)
        fit = None if seen_tag is None else _fitted(camera, seen_tag, corners)
        if seen_tag is None or fit is None or abs(fit.scale - 1) > EDGE_SHARE:
            self._missed += 1
            return None
        self._missed, self._last_px = 0, seen_tag.corners_px
        self._learn_noise(_misses_px(camera, seen_tag, corners, fit))
        corner_px = max(CORNER_PX, float(np.sqrt(self._variance_px2)))
        covariance = _covariance(camera, seen_tag, float(corners[:, 2].mean()), corner_px)
        return SeenRobot(fit.pose, covariance, seen_tag, _quality(seen_tag, fit.residual_m / self.tag.edge_m))

    def _learn_noise(self, misses_px: FloatArray) -> None:
        """Take in by how much the corners (4, 2) of one picture miss the square that fits them best."""
        self._pictures = min(self._pictures + 1, MOST_PICTURES)
        told_px2 = float(np.square(misses_px).sum()) / _FREE
        self._variance_px2 += (told_px2 - self._variance_px2) / self._pictures

    def _tag_at(
        self, gray: Picture, camera: Camera, corners: FloatArray, expected: PlanarPose | None
    ) -> SeenTag | None:
        tag_id = self.tag.tag_id
        for corners_px in (_expected_px(camera, corners, expected), self._last_px):
            if corners_px is not None:
                found = self._finder.near(gray, {tag_id: corners_px})
                if found:
                    return found[tag_id]
        if self._missed % SEARCH_EVERY:
            return None
        thorough = (self._missed // SEARCH_EVERY) % THOROUGH_EVERY == 0
        return self._finder.search(gray, thorough=thorough).get(tag_id)


def _expected_px(camera: Camera, corners: FloatArray, expected: PlanarPose | None) -> FloatArray | None:
    """Where corners (4, 3), given in the levelled frame below the robot's base, should be seen."""
    if expected is None:
        return None
    return camera.pixels(np.column_stack([expected.of_points(corners[:, :2]), corners[:, 2]]))


def _fitted(camera: Camera, seen_tag: SeenTag, corners: FloatArray) -> PlanarFit | None:
    seen = camera.floor_points(seen_tag.corners_px, corners[:, 2])
    return fitted_pose(corners[:, :2], seen) if np.isfinite(seen).all() else None


def _misses_px(camera: Camera, seen_tag: SeenTag, corners: FloatArray, fit: PlanarFit) -> FloatArray:
    """By how much the corners are seen elsewhere than a square of any size has them, (4, 2)."""
    middle = corners[:, :2].mean(axis=0)
    scaled = middle + fit.scale * (corners[:, :2] - middle)
    return camera.pixels(np.column_stack([fit.pose.of_points(scaled), corners[:, 2]])) - seen_tag.corners_px


def _covariance(camera: Camera, seen_tag: SeenTag, height_m: float, corner_px: float) -> FloatArray:
    """Covariance (3, 3) of x, y and yaw from corner noise and remaining systematic errors."""
    around = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]) + seen_tag.corners_px.mean(axis=0)
    middle, right, down = camera.floor_points(around, height_m)
    per_px = np.column_stack([right - middle, down - middle])
    covariance = np.zeros((3, 3))
    # Means of four corners, which are half a diagonal away from the middle.
    covariance[:2, :2] = per_px @ per_px.T * corner_px**2 / 4 + np.eye(2) * FLOOR_M**2
    covariance[2, 2] = (corner_px / seen_tag.edge_px) ** 2 / 2
    return covariance


def _quality(seen_tag: SeenTag, residual: float) -> float:
    """Quality, 0 to 1: of an edge of 15 to 30 px, a contrast of 20 to 60, and corners of a square."""
    parts = (seen_tag.edge_px / 30, seen_tag.margin / 60, 1 - residual / 0.05)
    return float(np.clip(min(parts), 0.0, 1.0))
