"""The floor as a mesh in its own plane: z is the height above it; x and y are the world's on level ground."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hexctl.backends.sim.terrain import ROUGH_HALF_SIZE_M
from hexctl.record.style import GROUND_COLOR
from hexctl.types import FloatArray

#: Floor to be seen on all sides of the planned path; an even one costs nothing.
MARGIN_M = 2.0
EVEN_MARGIN_M = 50.0

#: More vertices than this are thinned out, to keep the file small.
MAX_VERTICES = 40_000

#: An even floor lies this much below the feet, so that lines drawn on it stay visible.
SUNK_M = 0.002


@dataclass(frozen=True, slots=True)
class Mesh:
    """Triangles in the floor's plane.

    Attributes:
        positions: (V, 3) in m.
        triangles: (T, 3) indices of vertices.
        normals: (V, 3).
        colors: (V, 3), red, green, blue.
    """

    positions: NDArray[np.float32]
    triangles: NDArray[np.uint32]
    normals: NDArray[np.float32]
    colors: NDArray[np.uint8]


def make_mesh(heights_m: FloatArray | None, path_end_m: FloatArray) -> Mesh:
    """Return the floor around a straight path from the origin to an end, (2,) in m.

    Args:
        heights_m: the whole height field (rows along y, columns along x), or None for an even floor.
        path_end_m: where a walk without slip would end.
    """
    margin_m = EVEN_MARGIN_M if heights_m is None else MARGIN_M
    low = np.minimum(path_end_m, 0.0) - margin_m
    high = np.maximum(path_end_m, 0.0) + margin_m
    if heights_m is None:
        x, y = (np.array([low[axis], high[axis]]) for axis in (0, 1))
        return _grid_mesh(x, y, np.full((2, 2), -SUNK_M))
    columns, rows = (_cells(low[axis], high[axis], heights_m.shape[1 - axis]) for axis in (0, 1))
    stride = int(np.ceil(np.sqrt(len(rows) * len(columns) / MAX_VERTICES)))
    columns, rows = columns[::stride], rows[::stride]
    x, y = (_coordinates(heights_m.shape[1 - axis])[cells] for axis, cells in ((0, columns), (1, rows)))
    return _grid_mesh(x, y, heights_m[np.ix_(rows, columns)])


def _coordinates(count: int) -> FloatArray:
    return np.linspace(-ROUGH_HALF_SIZE_M, ROUGH_HALF_SIZE_M, count)


def _cells(low_m: float, high_m: float, count: int) -> NDArray[np.int64]:
    """Return which grid points of the field lie in a range, at least the two at its edge."""
    inside = np.flatnonzero((_coordinates(count) >= low_m) & (_coordinates(count) <= high_m))
    return inside if inside.size > 1 else np.array([0, 1])


def _grid_mesh(x: FloatArray, y: FloatArray, heights: FloatArray) -> Mesh:
    """Return the mesh of heights (len(y), len(x)) over a rectangular grid."""
    positions = np.stack([*np.meshgrid(x, y), heights], axis=-1)
    slope_y, slope_x = np.gradient(heights, y, x)
    normals = np.stack([-slope_x, -slope_y, np.ones_like(heights)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    spread = np.clip(heights / (2 * heights.std() + 1e-9), -1, 1) if heights.std() > 0 else 0 * heights
    colors = np.array(GROUND_COLOR) * (1 + 0.35 * spread[..., np.newaxis])
    corner = np.arange(heights.size, dtype=np.uint32).reshape(heights.shape)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
    triangles = np.concatenate(
        [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    )
    return Mesh(
        positions.reshape(-1, 3).astype(np.float32),
        triangles,
        normals.reshape(-1, 3).astype(np.float32),
        colors.reshape(-1, 3).astype(np.uint8),
    )
