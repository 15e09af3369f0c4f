"""The static part of a recording: floor, robot parts, and names and colours of the rest."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexctl.backends.sim.terrain import ROUGH_HALF_SIZE_M, Floor
from hexctl.control.trace import TrialFrame
from hexctl.control.trial_plan import TrialPlan
from hexctl.gait.gait import ideal_speed_m_s
from hexctl.palette import BODY_COLOR, GROUND_COLOR, TEXT_COLOR
from hexctl.recording import paths, style
from hexctl.recording.rrd import load_rerun
from hexctl.recording.series import SERVOS, WALK, rounded
from hexctl.robot.meshes import Meshes, PartMesh
from hexctl.robot.model import Robot
from hexctl.robot.rotations import xyzw
from hexctl.types import JOINT_KINDS, N_LEGS, FloatArray

#: Visible distance to each side of the robot, in stance radii. The viewer uses this size or the layout's
#: eye, whichever it gets first; both give the same picture.
FRAME_SHARE = 1.3


@dataclass(frozen=True, slots=True)
class Subject:
    """The robot, its plan, the floor and the meshes of a recording."""

    robot: Robot
    plan: TrialPlan
    floor: Floor
    meshes: Meshes = field(default_factory=dict)

    def mesh_of(self, leg: int, kind: str) -> PartMesh | None:
        """Mesh of a link; None if it is drawn as a solid, as for an announced missing leg, an outline."""
        missing = any(one.leg == leg and one.kind == "missing" for one in self.plan.failures)
        return None if missing else self.meshes.get(kind)


LEVEL = Floor(np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]), None)


def course_world(frame: TrialFrame, length_m: float, floor: Floor) -> FloatArray:
    """Both ends of the line of travel, just above the floor, (2, 3) in m."""
    steps = np.array([[0.0], [length_m]]) * [np.cos(frame.heading_rad), np.sin(frame.heading_rad)]
    return on_floor(frame.origin_world[:2] + steps, floor)


def on_floor(points_m: FloatArray, floor: Floor) -> FloatArray:
    """Horizontal positions, (N, 2), raised just above the floor and most of its bumps, (N, 3)."""
    above_m = SUNK_M if floor.heights_m is None else 1.5 * float(floor.heights_m.std())
    heights = above_m - points_m @ floor.normal_world[:2] / floor.normal_world[2]
    return np.column_stack([points_m, heights])


def path_end_m(robot: Robot, plan: TrialPlan) -> FloatArray:
    """End of a walk without slip, (2,) in m from its start."""
    length = ideal_speed_m_s(robot, plan.gait, plan.motion(0.0)) * plan.duration_s
    return length * np.array([math.cos(plan.heading_rad), math.sin(plan.heading_rad)])


def send_scene(stream: Any, subject: Subject, *, servos: bool) -> None:
    """Send the static part of a recording; `servos` is whether single servos may report."""
    rr, robot = load_rerun(), subject.robot
    stream.log(paths.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    _send_floor(stream, subject.floor, path_end_m(robot, subject.plan))
    _send_body(stream, robot, subject.meshes)
    for leg in paths.LEGS:
        _send_leg(stream, subject, leg)
    _send_frame(stream, robot)
    _send_looks(stream, robot)
    for series in (*WALK, *SERVOS) if servos else WALK:
        widths = {} if series.widths is None else {"widths": series.widths}
        lines = rr.SeriesLines(colors=list(series.colors), names=list(series.names), **widths)
        stream.log(series.path, lines, static=True)


def _send_frame(stream: Any, robot: Robot) -> None:
    """Send a triangle without area that spans the visible surroundings of the robot."""
    reach = FRAME_SHARE * robot.stance_radius_m
    corners = [[-reach, -reach, -robot.standing_height_m], [reach, reach, 0.0]]
    stream.log(
        paths.FRAME, load_rerun().Mesh3D(vertex_positions=corners, triangle_indices=[[0, 1, 1]]), static=True
    )


def _send_looks(stream: Any, robot: Robot) -> None:
    rr, foot_m = load_rerun(), robot.foot_radius_m
    foot = rr.Points3D.from_fields(radii=[1.2 * foot_m])
    for path, color, radius, *ends in (
        (paths.TRAIL, style.TRAIL_COLOR, foot_m / 3),
        (paths.COURSE, style.COURSE_COLOR, foot_m / 4),
        (paths.CENTRE, style.PLUMB_COLOR, foot_m / 6, foot),
    ):
        look = rr.LineStrips3D.from_fields(colors=[color], radii=[radius])
        stream.log(path, look, *ends, static=True)
    quad = rr.Mesh3D.from_fields(triangle_indices=[[0, 2, 3], [0, 3, 1]])
    stream.log(paths.RIBBON, quad, static=True)
    fan = rr.Mesh3D.from_fields(triangle_indices=[[0, corner, corner + 1] for corner in range(1, N_LEGS - 1)])
    stream.log(paths.POLYGON, fan, static=True)


def _send_floor(stream: Any, floor: Floor, end_m: FloatArray) -> None:
    pose = load_rerun().Transform3D(quaternion=xyzw(floor.quaternion_world))
    stream.log(paths.GROUND, make_floor_mesh(floor.heights_m, end_m), pose, static=True)


def _send_body(stream: Any, robot: Robot, meshes: Meshes) -> None:
    """Send the trunk and a mark at its front: the `ant` is symmetric."""
    rr = load_rerun()
    if "body" in meshes:
        stream.log(paths.BODY, *_asset(meshes["body"], BODY_COLOR), static=True)
    else:
        stream.log(paths.BODY, _trunk(robot), static=True)
    length, _, height = robot.body.size_m
    size = 0.12 * length
    nose = rr.Boxes3D(
        centers=[[length / 2 - 1.5 * size, 0, height / 2]],
        half_sizes=[[size, size / 2, 0.1 * size]],
        colors=[style.NOSE_COLOR],
        fill_mode="solid",
    )
    stream.log(f"{paths.BODY}/front", nose, static=True)


def _send_leg(stream: Any, subject: Subject, leg: int) -> None:
    """Send mount, links and foot of a leg; their colours change with a failure and are tracks."""
    rr, robot = load_rerun(), subject.robot
    yaw = rr.RotationAxisAngle([0, 0, 1], radians=float(robot.mount_yaws_rad[leg - 1]))
    mount = rr.Transform3D(translation=robot.mount_positions_body[leg - 1], rotation=yaw)
    stream.log(paths.leg_path(leg), mount, static=True)
    start = (0.0, 0.0)
    for index, kind in enumerate(JOINT_KINDS):
        if index:
            joint = rr.Transform3D(translation=[start[0], 0.0, start[1]])
            stream.log(paths.joint_path(leg, kind), joint, static=True)
        mesh = subject.mesh_of(leg, kind)
        parts = [_capsule(robot, index)] if mesh is None else _asset(mesh, None)
        stream.log(paths.link_path(leg, kind), *parts, static=True)
        start = tuple(robot.link_vectors_m[index])
    place = [start[0], 0.0, start[1]]
    foot = rr.Points3D([place], radii=[1.3 * robot.foot_radius_m], show_labels=False)
    stream.log(paths.foot_path(leg), foot, static=True)
    label = rr.Points3D([place], radii=[0.0], colors=[TEXT_COLOR], show_labels=True)
    stream.log(paths.label_path(paths.foot_path(leg)), label, static=True)


def _trunk(robot: Robot) -> Any:
    rr = load_rerun()
    length, width, height = robot.body.size_m
    look = {"colors": [BODY_COLOR], "fill_mode": "solid"}
    if robot.body.shape == "box":
        return rr.Boxes3D(half_sizes=[[length / 2, width / 2, height / 2]], **look)
    return rr.Cylinders3D(lengths=[height], radii=[length / 2], **look)


def _capsule(robot: Robot, index: int) -> Any:
    outward, up = robot.link_vectors_m[index]
    tilt = math.atan2(outward, up)  # a capsule points along z until it is turned
    return load_rerun().Capsules3D(
        lengths=[math.hypot(outward, up)],
        radii=[robot.link_radii_m[index]],
        quaternions=[[0, math.sin(tilt / 2), 0, math.cos(tilt / 2)]],
    )


def _asset(mesh: PartMesh, color: style.Color | None) -> list[Any]:
    """A mesh and its pose; `color` applies to a mesh without colours."""
    rr = load_rerun()
    w, x, y, z = mesh.quaternion.tolist()
    pose = rr.InstancePoses3D(
        translations=[mesh.position_m], quaternions=[[x, y, z, w]], scales=[[mesh.scale] * 3]
    )
    look = {} if color is None or mesh.coloured else {"albedo_factor": color}
    return [rr.Asset3D(contents=mesh.content, media_type=mesh.media_type, **look), pose]


#: Margin of the floor around the planned path; an even one has only four corners.
FLOOR_MARGIN_M = 1.5
EVEN_MARGIN_M = 50.0

#: More vertices than this are thinned out, to keep the file small.
MAX_VERTICES = 10_000

#: Binary places of normals, which shade the floor.
NORMAL_BITS = 6

#: An even floor lies this much below the feet, to keep lines on it visible.
SUNK_M = 0.002


def make_floor_mesh(heights_m: FloatArray | None, path_end_m: FloatArray) -> Any:
    """Rerun's mesh of heights (rows along y) around a straight path from the origin to `path_end_m`, (2,)."""
    margin_m = EVEN_MARGIN_M if heights_m is None else FLOOR_MARGIN_M
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
    inside = np.flatnonzero((_coordinates(count) >= low_m) & (_coordinates(count) <= high_m))
    return inside if inside.size > 1 else np.array([0, 1])


def _grid_mesh(x: FloatArray, y: FloatArray, heights: FloatArray) -> Any:
    positions = np.stack([*np.meshgrid(x, y), heights], axis=-1)
    slope_y, slope_x = np.gradient(heights, y, x)
    normals = np.stack([-slope_x, -slope_y, np.ones_like(heights)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    spread = np.clip(heights / (2 * heights.std() + 1e-9), -1, 1) if heights.std() > 0 else 0 * heights
    colors = np.array(GROUND_COLOR) * (1 + 0.35 * spread[..., np.newaxis])
    corner = np.arange(heights.size, dtype=np.uint32).reshape(heights.shape)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
    triangles = np.stack([a, b, c, a, c, d], -1).reshape(-1, 3)  # neighbours compress well
    return load_rerun().Mesh3D(
        vertex_positions=positions.reshape(-1, 3).astype(np.float32),
        triangle_indices=triangles,
        vertex_normals=rounded(normals, NORMAL_BITS).reshape(-1, 3).astype(np.float32),
        vertex_colors=colors.reshape(-1, 3).astype(np.uint8),
    )
