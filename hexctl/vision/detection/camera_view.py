"""What of the floor a camera sees well enough: the arena it gives."""

import math

import cv2
import numpy as np

from hexctl.errors import InputError
from hexctl.types import BoolArray, FloatArray
from hexctl.vision.detection.camera import Camera
from hexctl.vision.detection.tags import LEAST_EDGE_PX

#: Distance between the points of the floor that are looked at, and how far from the camera they reach, in m.
STEP_M, REACH_M = 0.05, 8.0

#: Edge that a tag should have in its narrow direction to be found in every picture, in px.
EDGE_PX = 1.25 * LEAST_EDGE_PX


def visible_circle(camera: Camera, height_m: float, edge_m: float) -> tuple[tuple[float, float], float]:
    """Middle (x, y) in m and radius in m of the largest circle on the floor in which a tag is seen.

    Args:
        camera: as it stands.
        height_m: of the tag above the floor.
        edge_m: of the tag.

    Raises InputError for a camera that sees no such place.
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
    # Of circles that are as large, the one in the middle of what is seen.
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
    # Far from the axis the polynomials of a lens come back into the picture.
    ahead = (corners - camera.position_floor) @ camera.rotation
    low, high = _edges(camera)
    within = (ahead[..., 2] > 0)[..., np.newaxis] & (ahead[..., :2] > low * ahead[..., 2:])
    within &= ahead[..., :2] < high * ahead[..., 2:]
    corners_px = camera.pixels(corners.reshape(-1, 3)).reshape(-1, 4, 2)
    size = np.array([camera.lens.width_px, camera.lens.height_px])
    inside = ((corners_px > 0) & (corners_px < size - 1)).all(axis=(1, 2))
    # Seen at an angle a tag is narrow: by the smaller of the two axes into which a circle would be drawn.
    axes_px = np.stack([corners_px[:, 0] - corners_px[:, 2], corners_px[:, 1] - corners_px[:, 3]], axis=-1)
    narrow_px = np.linalg.svd(np.nan_to_num(axes_px), compute_uv=False)[:, -1] / math.sqrt(2)
    return np.asarray(within.all(axis=(1, 2)) & inside & (narrow_px > EDGE_PX))


def _edges(camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Least and greatest x / z and y / z of rays in the picture."""
    lens = camera.lens
    columns, rows = np.linspace(0, lens.width_px - 1, 33), np.linspace(0, lens.height_px - 1, 33)
    border = np.concatenate(
        [np.column_stack([columns, np.full(33, row)]) for row in (rows[0], rows[-1])]
        + [np.column_stack([np.full(33, column), rows]) for column in (columns[0], columns[-1])]
    )
    rays = lens.rays(border)[:, :2]
    return np.nanmin(rays, axis=0), np.nanmax(rays, axis=0)
