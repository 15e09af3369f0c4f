"""What never changes in a recording: the floor, the robot's parts, names and colours of the rest."""

import math
from typing import Any

import numpy as np

from hexctl.backends.sim.terrain import Floor
from hexctl.control.frame import TrialFrame
from hexctl.control.plan import TrialPlan
from hexctl.gait.gait import ideal_speed_m_s
from hexctl.record import paths, style
from hexctl.record.ground import SUNK_M, make_mesh
from hexctl.record.sdk import load_rerun
from hexctl.record.solids import send_body, send_leg
from hexctl.robot.meshes import Meshes
from hexctl.robot.model import Robot
from hexctl.types import N_LEGS, FloatArray

#: How far the eye shall see to each side of the robot, in stance radii. The viewer goes by this size or by
#: the layout's eye, whichever it has first: both give the same picture.
FRAME_SHARE = 1.3

LEVEL = Floor(np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]), None)


def xyzw(quaternion: FloatArray) -> FloatArray:
    """Return quaternions (w, x, y, z) in Rerun's order (x, y, z, w), any leading shape + (4,)."""
    return np.roll(quaternion, -1, axis=-1)


def course_world(frame: TrialFrame, length_m: float, floor: Floor) -> FloatArray:
    """Return both ends of the line of travel, just above the floor, (2, 3) in m."""
    steps = np.array([[0.0], [length_m]]) * [np.cos(frame.heading_rad), np.sin(frame.heading_rad)]
    return on_floor(frame.origin_world[:2] + steps, floor)


def on_floor(points_m: FloatArray, floor: Floor) -> FloatArray:
    """Return points seen from above, (N, 2), as points just above the floor and most of its bumps, (N, 3)."""
    above_m = SUNK_M if floor.heights_m is None else 1.5 * float(floor.heights_m.std())
    heights = above_m - points_m @ floor.normal_world[:2] / floor.normal_world[2]
    return np.column_stack([points_m, heights])


def path_end_m(robot: Robot, plan: TrialPlan) -> FloatArray:
    """Return where a walk without slip would end, (2,) in m from its start."""
    length = ideal_speed_m_s(robot, plan.gait, plan.motion(0.0)) * plan.duration_s
    return length * np.array([math.cos(plan.heading_rad), math.sin(plan.heading_rad)])


def send_scene(stream: Any, robot: Robot, plan: TrialPlan, floor: Floor, meshes: Meshes) -> None:
    """Send everything that stays as it is to a recording stream."""
    rr = load_rerun()
    stream.log(paths.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    _send_floor(stream, floor, path_end_m(robot, plan))
    send_body(stream, robot, meshes)
    for leg in paths.LEGS:
        send_leg(stream, robot, plan, meshes, leg)
    _send_frame(stream, robot)
    _send_looks(stream, robot)
    for path, name, color in (
        (paths.DEVIATION, "left of the line (m)", style.DEVIATION_COLOR),
        (paths.MARGIN, "inside the feet (m)", style.MARGIN_COLOR),
    ):
        line = rr.SeriesLines(colors=[color], names=[name], widths=[2.0])
        stream.log(path, line, static=True)


def _send_frame(stream: Any, robot: Robot) -> None:
    """Send a triangle without area that spans what the eye shall see of the robot and around it."""
    reach = FRAME_SHARE * robot.stance_radius_m
    corners = [[-reach, -reach, -robot.standing_height_m], [reach, reach, 0.0]]
    stream.log(
        paths.FRAME, load_rerun().Mesh3D(vertex_positions=corners, triangle_indices=[[0, 1, 1]]), static=True
    )


def _send_looks(stream: Any, robot: Robot) -> None:
    """Send what is the same at all times about what is drawn on the floor."""
    rr, foot_m = load_rerun(), robot.foot_radius_m
    for path, color, radius in (
        (paths.TRAIL, style.TRAIL_COLOR, foot_m / 3),
        (paths.COURSE, style.COURSE_COLOR, foot_m / 4),
        (paths.CENTRE, style.PLUMB_COLOR, foot_m / 6),
    ):
        look = rr.LineStrips3D.from_fields(colors=[color], radii=[radius])
        stream.log(path, look, static=True)
    stream.log(paths.CENTRE, rr.Points3D.from_fields(radii=[1.2 * foot_m]), static=True)
    quad = rr.Mesh3D.from_fields(triangle_indices=[[0, 2, 3], [0, 3, 1]])
    stream.log(paths.RIBBON, quad, static=True)
    fan = rr.Mesh3D.from_fields(triangle_indices=[[0, corner, corner + 1] for corner in range(1, N_LEGS - 1)])
    stream.log(paths.POLYGON, fan, static=True)


def _send_floor(stream: Any, floor: Floor, end_m: FloatArray) -> None:
    rr = load_rerun()
    mesh = make_mesh(floor.heights_m, end_m)
    solid = rr.Mesh3D(
        vertex_positions=mesh.positions,
        triangle_indices=mesh.triangles,
        vertex_normals=mesh.normals,
        vertex_colors=mesh.colors,
    )
    pose = rr.Transform3D(quaternion=xyzw(floor.quaternion_world))
    stream.log(paths.GROUND, solid, pose, static=True)
