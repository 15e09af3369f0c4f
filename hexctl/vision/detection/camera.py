"""A camera over a floor: projection, pose from tags, and the area where it detects tags."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from hexctl.errors import InputError
from hexctl.types import ArrayFields, BoolArray, FloatArray
from hexctl.vision.detection.lens import Lens
from hexctl.vision.detection.tags import LEAST_EDGE_PX

#: Spacing of the sampled floor points and their maximum distance from the camera, in m.
STEP_M, REACH_M = 0.05, 8.0

#: Points are in view up to this multiple of what the edges of the picture see.
IN_VIEW = 1.1

#: Edge that a tag should have in its narrow direction to be found in every picture, in px.
EDGE_PX = 1.25 * LEAST_EDGE_PX


@dataclass(frozen=True, slots=True, eq=False)
class Camera(ArrayFields):
    """A lens at a pose over the floor, whose frame has z up and z = 0 on the floor.

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
        """Camera at a position that looks at a point, its pictures upright."""
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
        """Project points (N, 3) in the floor's frame to pixels (N, 2); NaN behind the camera."""
        return self.lens.pixels((points_floor - self.position_floor) @ self.rotation)

    def moved_from(self, other: "Camera") -> tuple[float, float]:
        """Distance in m and angle in rad from another pose to this one."""
        shift_m = float(np.linalg.norm(self.position_floor - other.position_floor))
        return shift_m, float(np.linalg.norm(cv2.Rodrigues(self.rotation.T @ other.rotation)[0]))

    def pixels_in_view(self, points_floor: FloatArray) -> FloatArray:
        """As `pixels`; NaN far outside too, where the distortion of a lens folds back into the picture."""
        lens = self.lens
        right, bottom = lens.width_px - 1.0, lens.height_px - 1.0
        edge_px = np.array([[x, y] for x in (0.0, right / 2, right) for y in (0.0, bottom / 2, bottom)])
        widest = np.nanmax(np.hypot(*lens.rays(edge_px)[:, :2].T))
        points = (points_floor - self.position_floor) @ self.rotation
        seen = lens.pixels(points)
        seen[np.hypot(points[:, 0], points[:, 1]) > IN_VIEW * widest * points[:, 2]] = math.nan
        return seen


def place_camera(
    lens: Lens, corners_px: Mapping[int, FloatArray], corners_floor: Mapping[int, FloatArray]
) -> Camera | None:
    """Camera that sees tags on the floor where they are seen, or None without a solution.

    Corners (4, 2) are by number, in the picture and on the floor; tags that only one has are not used.
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


def visible_circle(camera: Camera, height_m: float, edge_m: float) -> tuple[tuple[float, float], float]:
    """Middle (x, y) and radius in m of the largest circle on the floor in which a tag at a height is seen.

    Raises InputError for a camera that sees none.
    """
    steps = np.arange(-REACH_M, REACH_M, STEP_M)
    x, y = np.meshgrid(camera.position_floor[0] + steps, camera.position_floor[1] + steps)
    seen = sees_tags(camera, np.column_stack([x.ravel(), y.ravel()]), height_m, edge_m).reshape(x.shape)
    # Nothing is known of the floor beyond the last points.
    seen[[0, -1], :] = seen[:, [0, -1]] = False
    if not seen.any():
        raise InputError(
            f"the camera sees a tag of {1000 * edge_m:g} mm nowhere on the floor with {EDGE_PX:.0f} px; "
            "allowed: nearer, lower, or a larger tag"
        )
    room_steps = cv2.distanceTransform(seen.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    # Among equally large circles, the one nearest the middle of the visible area.
    large = room_steps >= room_steps.max() - 0.5
    away_m = np.hypot(x - x[seen].mean(), y - y[seen].mean())
    row, column = np.unravel_index(int(np.where(large, away_m, np.inf).argmin()), seen.shape)
    middle = (float(x[row, column]), float(y[row, column]))
    return middle, float(room_steps[row, column] - 1) * STEP_M


def sees_tags(camera: Camera, points: FloatArray, height_m: float, edge_m: float) -> BoolArray:
    """Whether a tag that lies level is seen whole and large enough at points (N, 2) of the floor, (N,)."""
    half_m = edge_m / math.sqrt(2)
    offsets = half_m * np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
    corners = np.column_stack([points, np.full(len(points), height_m)])[:, np.newaxis] + offsets
    corners_px = camera.pixels_in_view(corners.reshape(-1, 3)).reshape(-1, 4, 2)
    size = np.array([camera.lens.width_px, camera.lens.height_px])
    inside = ((corners_px > 0) & (corners_px < size - 1)).all(axis=(1, 2))
    # Seen at an angle a tag is narrow: by the smaller of the two axes into which a circle would be drawn.
    axes_px = np.stack([corners_px[:, 0] - corners_px[:, 2], corners_px[:, 1] - corners_px[:, 3]], axis=-1)
    narrow_px = np.linalg.svd(np.nan_to_num(axes_px), compute_uv=False)[:, -1] / math.sqrt(2)
    return np.asarray(inside & (narrow_px > EDGE_PX))
