"""A camera at a place: where on a level plane its pixels look, and where it stands by the tags it sees."""

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from hexctl.types import ArrayFields, FloatArray
from hexctl.vision.detection.lens import Lens


@dataclass(frozen=True, slots=True, eq=False)
class Camera(ArrayFields):
    """A lens at a place over the floor, whose frame has z up and z = 0 on the floor.

    Attributes:
        lens: of the camera.
        rotation: (3, 3), from the camera's frame to the floor's.
        position_floor: of the lens, (3,) in m.
    """

    lens: Lens
    rotation: FloatArray
    position_floor: FloatArray

    @classmethod
    def looking(cls, lens: Lens, position_floor: FloatArray, target_floor: FloatArray) -> "Camera":
        """Camera at a place that looks at a point, its pictures upright."""
        ahead = np.asarray(target_floor, dtype=float) - position_floor
        ahead = ahead / np.linalg.norm(ahead)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        if np.linalg.norm(right) < 1e-6:  # straight down: the floor's y is up in the picture
            right = np.array([1.0, 0.0, 0.0])
        right = right / np.linalg.norm(right)
        rotation = np.column_stack([right, np.cross(ahead, right), ahead])
        return cls(lens, rotation, np.asarray(position_floor, dtype=float))

    def floor_points(self, points_px: FloatArray, height_m: float | FloatArray = 0.0) -> FloatArray:
        """Where the rays of pixels (N, 2) meet the level plane at a height, or at one each, (N, 2) in m.

        NaN for rays that do not meet it in front of the camera.
        """
        directions = self.lens.rays(points_px) @ self.rotation.T
        with np.errstate(divide="ignore", invalid="ignore"):
            length = (height_m - self.position_floor[2]) / directions[:, 2]
            length = np.where(length > 0, length, np.nan)
            return np.asarray(self.position_floor[:2] + length[:, np.newaxis] * directions[:, :2])

    def pixels(self, points_floor: FloatArray) -> FloatArray:
        """Where points (N, 3) over the floor are seen, (N, 2) in px; NaN for what is behind the camera."""
        return self.lens.pixels((points_floor - self.position_floor) @ self.rotation)

    @property
    def tilt_rad(self) -> float:
        """Angle between where it looks and the floor: pi/2 straight down."""
        return float(np.arcsin(np.clip(-self.rotation[2, 2], -1, 1)))


def place_camera(
    lens: Lens, corners_px: Mapping[int, FloatArray], corners_floor: Mapping[int, FloatArray]
) -> Camera | None:
    """Camera that sees tags on the floor where they are seen, or None without a solution.

    Args:
        lens: of the camera.
        corners_px: corners (4, 2) of tags in the picture, by number.
        corners_floor: corners (4, 2) of tags on the floor in m, by number; tags without are not used.
    """
    shared = sorted(set(corners_px) & set(corners_floor))
    if not shared:
        return None
    found = camera_candidates(
        lens,
        np.concatenate([corners_px[tag_id] for tag_id in shared]),
        np.concatenate([corners_floor[tag_id] for tag_id in shared]),
    )
    return found[0] if found else None


def camera_candidates(lens: Lens, points_px: FloatArray, points_floor: FloatArray) -> list[Camera]:
    """Cameras over the floor that see points of it (N, 2) at pixels (N, 2), the best first.

    Points in a plane have two solutions, which for a small tag far away fit nearly as well.
    """
    rays = lens.rays(points_px)
    if not np.isfinite(rays).all():
        return []
    seen = np.ascontiguousarray(rays[:, :2])
    points = np.column_stack([points_floor, np.zeros(len(points_floor))])
    none, unit = np.zeros(5), np.eye(3)
    count, turns, shifts, _ = cv2.solvePnPGeneric(points, seen, unit, none, flags=cv2.SOLVEPNP_IPPE)
    cameras = []
    for turn, shift in zip(turns[:count], shifts[:count], strict=True):
        turn, shift = cv2.solvePnPRefineLM(points, seen, unit, none, turn, shift)
        to_camera = cv2.Rodrigues(turn)[0]
        camera = Camera(lens, to_camera.T, -to_camera.T @ np.ravel(shift))
        if camera.position_floor[2] > 0:
            cameras.append(camera)
    return cameras


def reprojection_px(
    camera: Camera, corners_px: Mapping[int, FloatArray], corners_floor: Mapping[int, FloatArray]
) -> dict[int, float]:
    """How far tags on the floor are seen from where they should be: RMS of the corners, by number."""
    errors = {}
    for tag_id in set(corners_px) & set(corners_floor):
        points = np.column_stack([corners_floor[tag_id], np.zeros(4)])
        misses_px = camera.pixels(points) - corners_px[tag_id]
        errors[tag_id] = float(np.sqrt(np.square(misses_px).sum(axis=1).mean()))
    return errors
