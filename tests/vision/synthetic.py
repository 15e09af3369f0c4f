"""Corners of tags as a camera sees them, calculated instead of drawn, with noise."""

from collections.abc import Mapping

import numpy as np

from hexctl.robot.loader import load_robot
from hexctl.types import FloatArray
from hexctl.vision.detection.camera import Camera
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.detection.tags import Picture, SeenTag, TagFinder
from tests.vision.scenes import CAMERA, FLOOR_CORNERS, ROBOT_TAG, tag_on

ROBOT = load_robot("ant")
TAG = tag_on(ROBOT)

#: A picture that nobody looks at.
NO_PICTURE: Picture = np.zeros((720, 1280), dtype=np.uint8)


class CornerFinder(TagFinder):
    """Finds the tags where they are, whatever the picture shows.

    Args:
        noise_px: standard deviation of the coordinates of the robot's tag.
        seed: of it.
        camera: that sees them.

    Attributes:
        pose: of the robot.
    """

    def __init__(self, noise_px: float, seed: int = 0, camera: Camera = CAMERA) -> None:
        self._noise_px, self._random, self._camera = noise_px, np.random.default_rng(seed), camera
        self.pose = PlanarPose(0, 0, 0)

    def search(self, gray: Picture, *, thorough: bool = False) -> dict[int, SeenTag]:
        """All tags."""
        return {number: self._corners(number) for number in (*FLOOR_CORNERS, ROBOT_TAG)}

    def near(self, gray: Picture, expected_px: Mapping[int, FloatArray]) -> dict[int, SeenTag]:
        """The tags that are asked for."""
        return {number: self._corners(number) for number in expected_px}

    def _corners(self, number: int) -> SeenTag:
        corners, height_m, noise_px = FLOOR_CORNERS.get(number), 0.0, 0.0
        if corners is None:
            corners = self.pose.of_points(TAG.corners_body[:, :2])
            height_m, noise_px = ROBOT.standing_height_m + TAG.height_m, self._noise_px
        corners_px = self._camera.pixels(np.column_stack([corners, np.full(4, height_m)]))
        return SeenTag(number, corners_px + noise_px * self._random.normal(size=(4, 2)), 60.0)
