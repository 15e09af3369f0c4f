"""Where the robot is in a picture: its tag near where it is expected, else anywhere."""

from dataclasses import dataclass

import numpy as np

from hexctl.see.camera import Camera
from hexctl.see.planar_pose import PlanarPose, tag_pose
from hexctl.see.tags import UNIT_CORNERS, Picture, Sighted, TagFinder
from hexctl.types import ArrayFields, FloatArray

#: A tag whose edge looks longer or shorter than printed by more than this share is at another height, or is
#: another tag.
EDGE_SHARE = 0.15

#: Standard deviation of a corner, in px: noise, blur, and what is left of the lens's distortion.
CORNER_PX = 0.25

#: Standard deviation of the position that no number of pixels improves: of height and camera, in m.
FLOOR_M = 0.002

#: Pictures without the tag between two searches of the whole picture, of which every third is thorough.
SEARCH_EVERY, THOROUGH_EVERY = 3, 3


@dataclass(frozen=True, slots=True)
class RobotTag:
    """The tag on a robot.

    Attributes:
        tag_id: its number.
        edge_m: of its black square.
        mount: its pose in the frame of the robot's base, seen from above.
        height_m: above the origin of the base.
    """

    tag_id: int
    edge_m: float
    mount: PlanarPose
    height_m: float


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
    tag: Sighted
    quality: float


class RobotTracker:
    """Finds the tag of a robot in one picture after the other.

    Args:
        tag: on the robot.
        finder: of the tags.
    """

    def __init__(self, tag: RobotTag, finder: TagFinder) -> None:
        self.tag, self._finder = tag, finder
        self._last_px: FloatArray | None = None
        self._missed = 0

    def find(
        self, gray: Picture, camera: Camera, base_height_m: float, expected: PlanarPose | None = None
    ) -> SeenRobot | None:
        """The robot in a picture, or None.

        Args:
            gray: the picture, (H, W).
            camera: as it stands.
            base_height_m: of the robot's base above the floor.
            expected: where the robot should be, if anything tells.
        """
        height_m = base_height_m + self.tag.height_m
        sighted = self._sighted(gray, camera, height_m, expected)
        if sighted is None:
            self._missed += 1
            return None
        seen = tag_pose(camera, sighted, height_m)
        if seen is None or abs(seen.edge_m / self.tag.edge_m - 1) > EDGE_SHARE:
            self._missed += 1
            return None
        self._missed, self._last_px = 0, sighted.corners_px
        pose = seen.pose.after(self.tag.mount.inverse())
        covariance = _covariance(camera, sighted, height_m)
        return SeenRobot(pose, covariance, sighted, _quality(sighted, seen.residual_m / self.tag.edge_m))

    def _sighted(
        self, gray: Picture, camera: Camera, height_m: float, expected: PlanarPose | None
    ) -> Sighted | None:
        tag_id = self.tag.tag_id
        for corners_px in (self._expected_px(camera, height_m, expected), self._last_px):
            if corners_px is not None:
                found = self._finder.near(gray, {tag_id: corners_px})
                if found:
                    return found[tag_id]
        if self._missed % SEARCH_EVERY:
            return None
        thorough = (self._missed // SEARCH_EVERY) % THOROUGH_EVERY == 0
        return self._finder.search(gray, thorough=thorough).get(tag_id)

    def _expected_px(self, camera: Camera, height_m: float, expected: PlanarPose | None) -> FloatArray | None:
        if expected is None:
            return None
        corners = expected.after(self.tag.mount).of_points(self.tag.edge_m * UNIT_CORNERS)
        return camera.pixels(np.column_stack([corners, np.full(4, height_m)]))


def _covariance(camera: Camera, sighted: Sighted, height_m: float) -> FloatArray:
    """Covariance (3, 3) of x, y and yaw: what the noise of the corners does to them, and what is left."""
    around = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]) + sighted.corners_px.mean(axis=0)
    middle, right, down = camera.floor_points(around, height_m)
    per_px = np.column_stack([right - middle, down - middle])
    covariance = np.zeros((3, 3))
    # Means of four corners, which are half a diagonal away from the middle.
    covariance[:2, :2] = per_px @ per_px.T * CORNER_PX**2 / 4 + np.eye(2) * FLOOR_M**2
    covariance[2, 2] = (CORNER_PX / sighted.edge_px) ** 2 / 2
    return covariance


def _quality(sighted: Sighted, residual: float) -> float:
    """Quality, 0 to 1: of an edge of 15 to 30 px, a contrast of 20 to 60, and corners of a square."""
    parts = (sighted.edge_px / 30, sighted.margin / 60, 1 - residual / 0.05)
    return float(np.clip(min(parts), 0.0, 1.0))
