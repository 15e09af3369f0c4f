"""Tracks of the course: trail, line of travel, ribbon between them, deviation, and commanded velocity."""

import numpy as np
from numpy.typing import NDArray

from hexctl.columns import SPARSE_TICKS
from hexctl.control.trace import PHASES, TrialFrame
from hexctl.recording import paths, style
from hexctl.recording.rrd import load_rerun
from hexctl.recording.scene import course_world, on_floor, path_end_m
from hexctl.recording.series import DEVIATION
from hexctl.recording.tracks.block import Block, compact, posed_rows
from hexctl.types import FloatArray

#: Length of an arrow as time at the commanded velocity.
ARROW_S = 2.0
ARROW_RADIUS_M = 0.006

#: Ticks of a piece of the ribbon: fewer, longer pieces than the trail's, because each is a mesh.
RIBBON_TICKS = 10


def send_trail(block: Block) -> None:
    """Send the path of the body on the floor as short pieces; those before the time cursor are drawn."""
    at, first = _pieces(block, SPARSE_TICKS)
    if at.size:
        positions = block.log.rows("base_position_world", first, block.stop)[:, :2]
        ends = (on_floor(positions[index], block.subject.floor) for index in (at - SPARSE_TICKS, at))
        pieces = compact(np.stack(list(ends), axis=1))
        block.send(paths.TRAIL, at + first - block.start, load_rerun().LineStrips3D.columns(strips=pieces))


def send_course(block: Block) -> None:
    """Send the line of travel when the walk begins."""
    subject, frame = block.subject, block.log.frame
    rows = block.changes(block.led("phase"))
    rows = rows[block.column("phase")[rows] == PHASES.index("walk")]
    if frame is not None and rows.size and np.isfinite(frame.origin_world).all():
        length_m = float(np.linalg.norm(path_end_m(subject.robot, subject.plan)))
        line = course_world(frame, length_m, subject.floor).astype(np.float32)
        block.send(paths.COURSE, rows, load_rerun().LineStrips3D.columns(strips=[line]))


def send_ribbon(block: Block) -> None:
    """Send the area between the line of travel and the trail in pieces, coloured by side."""
    frame, rr = block.log.frame, load_rerun()
    at, first = _pieces(block, RIBBON_TICKS)
    walking = block.log.rows("phase", first, block.stop) == PHASES.index("walk")
    at = at[walking[at] & walking[at - RIBBON_TICKS]]
    if frame is None or not at.size:
        return
    positions = block.log.rows("base_position_world", first, block.stop)[:, :2]
    ends = [_across(frame, positions[index]) for index in (at - RIBBON_TICKS, at)]
    corners = np.concatenate([on for pair in ends for on in pair], axis=-1).reshape(-1, 2)
    quads = compact(on_floor(corners, block.subject.floor))
    left = frame.path(_with_height(positions[at]))[:, 1] >= 0
    colors = np.where(left, style.packed(style.LEFT_COLOR), style.packed(style.RIGHT_COLOR))
    columns = [
        *rr.Mesh3D.columns(vertex_positions=quads).partition(np.full(at.size, 4)),
        *rr.Mesh3D.columns(albedo_factor=colors.astype(np.uint32)),
    ]
    block.send(paths.RIBBON, at + first - block.start, columns)


def send_deviation(block: Block) -> None:
    """Send the deviation during the walk at 10 Hz, positive to the left."""
    frame = block.log.frame
    rows = block.sparse()
    rows = rows[(block.in_walk() & block.posed)[rows]]
    if frame is not None and rows.size:
        deviation = frame.path(block.column("base_position_world")[rows])[:, 1]
        block.plot(DEVIATION, rows, deviation)


def send_velocity(block: Block) -> None:
    """Send the commanded velocity of a steered walk as an arrow at 10 Hz."""
    velocity, rows, rr = block.column("velocity_body"), block.sparse(), load_rerun()
    rows = rows[np.isfinite(velocity[rows]).all(axis=-1)]
    if not rows.size:
        return
    # Not as static data: an arrow without a vector is an error of the scene, and open-loop walks have none.
    arrows = rr.Arrows3D.columns(
        vectors=compact(ARROW_S * np.column_stack([velocity[rows, :2], np.zeros(rows.size)])),
        origins=np.tile([0.0, 0.0, block.subject.robot.body.size_m[2]], (rows.size, 1)),
        colors=np.full(rows.size, style.packed(style.COURSE_COLOR), dtype=np.uint32),
        radii=np.full(rows.size, ARROW_RADIUS_M),
    )
    block.send(paths.VELOCITY_ARROW, rows, arrows)


def _pieces(block: Block, step: int) -> tuple[NDArray[np.int64], int]:
    """Known ends of pieces between multiples of a step in ticks, (N,), and the tick of their origin."""
    first = max(block.start, step)
    first += -first % step - step
    at = np.arange(step, block.stop - first, step)
    posed = posed_rows(block.log, first, block.stop)
    return at[posed[at] & posed[at - step]], first


def _across(frame: TrialFrame, points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    along = np.array([np.cos(frame.heading_rad), np.sin(frame.heading_rad)])
    progress = frame.path(_with_height(points_m))[:, :1]
    return points_m, frame.origin_world[:2] + progress * along


def _with_height(points_m: FloatArray) -> FloatArray:
    return np.column_stack([points_m, np.zeros(len(points_m))])
