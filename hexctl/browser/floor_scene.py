"""The floor of a world in viser's scene: a piece around the robot, and the line and the path on it."""

from typing import Any

import numpy as np

from hexctl.backends.sim.terrain import ROUGH_HALF_SIZE_M, Floor
from hexctl.palette import AXIS_COLOR, GROUND_COLOR, LINE_COLOR, PATH_COLOR
from hexctl.robot.rotations import matrix_of
from hexctl.types import FloatArray

#: Half side of an even floor's piece, and of an uneven one's, which has more triangles.
EVEN_HALF_M, UNEVEN_HALF_M = 3.0, 2.0

#: Distance between lines on an even floor, and between vertices of an uneven one.
LINES_M, VERTICES_M = 0.25, 0.04

#: Colour of an uneven floor, whose slopes are lighter and darker.
BUMPS_COLOR = (64, 74, 88)

#: The robot may be this far from the middle of a piece.
MOST_AWAY_M = 1.0

#: Points of the path are this far apart; the oldest go beyond the maximum.
PATH_STEP_M, MOST_PATH = 0.03, 300

#: Lines lie this much above an even floor, and above an uneven one.
ABOVE_M, ABOVE_BUMPS_M = 0.003, 0.01

#: Length of the line, from where the robot began.
LINE_M = 4.0


class FloorScene:
    """Draws the floor below a node of viser's scene, and moves its piece with the robot."""

    def __init__(self, scene: Any, name: str, floor: Floor) -> None:
        self._scene, self._name, self._floor = scene, name, floor
        self._node = scene.add_frame(name, show_axes=False, wxyz=floor.quaternion_world)
        self._middle: FloatArray | None = None
        self._path: list[FloatArray] = []
        self._drawn = 0

    def remove(self) -> None:
        """Take the floor, the line and the path out of the scene."""
        self._node.remove()

    def begin(self, position_m: FloatArray, heading_rad: float) -> None:
        """Begin a walk: draw the line ahead, and forget the path."""
        self._path, self._drawn = [], 0
        steps = np.linspace(0.0, LINE_M, 2 if self._floor.heights_m is None else 60)[:, np.newaxis]
        ahead = position_m[:2] + steps * [np.cos(heading_rad), np.sin(heading_rad)]
        self._draw("line", self._laid(ahead), LINE_COLOR)
        self._draw("path", np.zeros((2, 3)), PATH_COLOR)

    def follow(self, position_m: FloatArray) -> None:
        """Take the robot's position, (3,) in the world."""
        if self._middle is None or np.abs(position_m[:2] - self._middle).max() > MOST_AWAY_M:
            self._middle = np.round(position_m[:2] / LINES_M) * LINES_M
            self._draw_piece(self._middle)
        if not self._path or np.hypot(*(position_m[:2] - self._path[-1])) >= PATH_STEP_M:
            self._path = [*self._path[-MOST_PATH + 1 :], position_m[:2].copy()]

    def draw_path(self) -> None:
        """Draw the path, if it is longer than when it was drawn."""
        if len(self._path) >= 2 and len(self._path) != self._drawn:
            self._drawn = len(self._path) if len(self._path) < MOST_PATH else 0
            self._draw("path", self._laid(np.array(self._path)), PATH_COLOR)

    def _draw(self, part: str, points_m: FloatArray, color: Any) -> None:
        pairs = np.stack([points_m[:-1], points_m[1:]], axis=1).astype(np.float32)
        self._scene.add_line_segments(
            f"{self._name}/{part}", pairs, colors=color, thickness=3, thickness_units="screen"
        )

    def _laid(self, points_world: FloatArray) -> FloatArray:
        """Horizontal positions in the world, (n, 2), as points on the floor in its own frame, (n, 3)."""
        heights_m = heights_at(self._floor, points_world)
        points = np.column_stack([points_world, heights_m]) @ matrix_of(self._floor.quaternion_world)
        points[:, 2] += ABOVE_M if self._floor.heights_m is None else ABOVE_BUMPS_M
        return np.asarray(points)

    def _draw_piece(self, middle: FloatArray) -> None:
        even = self._floor.heights_m is None
        half, step = (EVEN_HALF_M, 2 * EVEN_HALF_M) if even else (UNEVEN_HALF_M, VERTICES_M)
        axis = np.linspace(-half, half, round(2 * half / step) + 1)
        centre = self._laid(middle[np.newaxis])[0, :2]
        x, y = np.meshgrid(axis + centre[0], axis + centre[1])
        plane = np.column_stack([x.ravel(), y.ravel()])
        heights = heights_in_plane(self._floor, plane)
        corner = np.arange(len(plane)).reshape(x.shape)
        a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
        self._scene.add_mesh_simple(
            f"{self._name}/ground",
            np.column_stack([plane, heights]).astype(np.float32),
            np.stack([a, b, c, a, c, d], -1).reshape(-1, 3),
            # Without a graphics card, the even floor's material takes a third of that which shows bumps.
            material="toon3" if even else "standard",
            flat_shading=not even,
            color=GROUND_COLOR if even else BUMPS_COLOR,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )
        if even:
            self._draw_lines(centre)

    def _draw_lines(self, centre: FloatArray) -> None:
        ends = np.arange(-EVEN_HALF_M, EVEN_HALF_M + LINES_M / 2, LINES_M)
        one, other = np.full_like(ends, -EVEN_HALF_M), np.full_like(ends, EVEN_HALF_M)
        along = np.stack([np.column_stack([ends, one]), np.column_stack([ends, other])], axis=1)
        lines = np.concatenate([along, along[:, :, ::-1]]) + centre
        flat = np.concatenate([lines, np.full((*lines.shape[:2], 1), ABOVE_M / 3)], axis=-1)
        self._scene.add_line_segments(
            f"{self._name}/lines",
            flat.astype(np.float32),
            colors=tuple(2 * c for c in AXIS_COLOR),
            thickness=1,
            thickness_units="screen",
        )


def heights_in_plane(floor: Floor, points_m: FloatArray) -> FloatArray:
    """Heights over the floor's plane at points of it, (n, 2), between its cells; 0 on an even one."""
    if floor.heights_m is None:
        return np.zeros(len(points_m))
    from scipy.ndimage import map_coordinates

    columns, rows = (points_m.T + ROUGH_HALF_SIZE_M) / (2 * ROUGH_HALF_SIZE_M) * (len(floor.heights_m) - 1)
    beyond_m = float(floor.heights_m.min())
    return np.asarray(map_coordinates(floor.heights_m, [rows, columns], order=1, cval=beyond_m))


def heights_at(floor: Floor, points_m: FloatArray) -> FloatArray:
    """Heights of the floor in the world at horizontal positions, (n, 2)."""
    heights_m = -points_m @ floor.normal_world[:2] / floor.normal_world[2]
    below = (np.column_stack([points_m, heights_m]) @ matrix_of(floor.quaternion_world))[:, :2]
    return np.asarray(heights_m + heights_in_plane(floor, below) / floor.normal_world[2])
