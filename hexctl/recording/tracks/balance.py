"""Tracks of the balance: support polygon, centre of gravity, and the margin between them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hexctl.ik.legs import link_points_body
from hexctl.ik.support_polygon import carried, centre_of_mass_of, support, to_world
from hexctl.recording import paths, style
from hexctl.recording.rrd import load_rerun
from hexctl.recording.scene import on_floor
from hexctl.recording.series import MARGIN
from hexctl.recording.tracks.block import Block, compact
from hexctl.types import BoolArray, FloatArray

#: The polygon lies this much above the ribbon and the line, and the mark of the centre above the polygon.
POLYGON_M, MARK_M = np.array([0.0, 0.0, 0.001]), np.array([0.0, 0.0, 0.002])


@dataclass(frozen=True, slots=True)
class Tally:
    """Number of ticks of the walk with a known centre of gravity, and with one inside the support polygon."""

    walked: int = 0
    inside: int = 0

    def __add__(self, other: "Tally") -> "Tally":
        return Tally(self.walked + other.walked, self.inside + other.inside)

    @property
    def share(self) -> float | None:
        """Share of the walk with the centre of gravity inside the support polygon; None before the walk."""
        return self.inside / self.walked if self.walked else None


def send_balance(block: Block) -> Tally:
    """Send the polygon, the centre of gravity and its margin at some ticks; count all ticks of the walk."""
    feet, centres = _feet_and_centres(block)
    known = np.asarray(np.isfinite(centres).all(axis=-1))
    rows = block.sparse()
    rows = rows[known[rows]]
    if rows.size:
        found = support(feet[rows], block.standing[rows], centres[rows, :2])
        inside = np.asarray(found.margin_m > 0)
        _send_polygon(block, rows, found.corners, inside)
        _send_centre(block, rows, centres[rows], inside)
        _send_margin(block, rows, found.margin_m)
    counted = np.flatnonzero(known & block.in_walk())
    inside = carried(feet[counted], block.standing[counted], centres[counted, :2])
    return Tally(counted.size, int(inside.sum()))


def _feet_and_centres(block: Block) -> tuple[FloatArray, FloatArray]:
    """Horizontal foot positions, (rows, 6, 2), and centres of gravity, (rows, 3), in the world."""
    robot = block.subject.robot
    links = link_points_body(robot, block.column("measured_rad"))
    centre = centre_of_mass_of(robot, links)[:, np.newaxis]
    pose = block.column("base_position_world"), block.column("base_quaternion_world")
    points = to_world(np.concatenate([links[..., -1, :], centre], axis=1), *pose)
    return points[:, :-1, :2], points[:, -1]


def _send_polygon(block: Block, rows: NDArray[np.int64], corners: FloatArray, inside: BoolArray) -> None:
    rr, count = load_rerun(), corners.shape[1]
    raised = on_floor(corners.reshape(-1, 2), block.subject.floor) + POLYGON_M
    points = compact(raised).reshape(-1, count, 3)
    columns = [
        *rr.Mesh3D.columns(vertex_positions=points.reshape(-1, 3)).partition(np.full(rows.size, count)),
        *rr.Mesh3D.columns(albedo_factor=_colors(inside, style.STEADY_FILL, style.UNSTEADY_FILL)),
    ]
    block.send(paths.POLYGON, rows, columns)


def _send_centre(block: Block, rows: NDArray[np.int64], centres: FloatArray, inside: BoolArray) -> None:
    rr = load_rerun()
    marks = on_floor(centres[:, :2], block.subject.floor) + MARK_M
    color = _colors(inside, style.STEADY_COLOR, style.UNSTEADY_COLOR)
    lines = np.stack([compact(marks), compact(centres)], axis=1)
    columns = [
        *rr.Points3D.columns(positions=lines[:, 0], colors=color),
        *rr.LineStrips3D.columns(strips=lines),
    ]
    block.send(paths.CENTRE, rows, columns)


def _send_margin(block: Block, rows: NDArray[np.int64], margin_m: FloatArray) -> None:
    finite = np.isfinite(margin_m)
    block.plot(MARGIN, rows[finite], margin_m[finite])


def _colors(inside: BoolArray, steady: style.Color, unsteady: style.Color) -> NDArray[np.uint32]:
    colors = np.array([style.packed(unsteady), style.packed(steady)], dtype=np.uint32)
    return np.asarray(colors[inside.astype(int)])
