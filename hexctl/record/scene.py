"""What never changes in a recording: floor, solids of the robot, names and colours of the plots."""

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
from hexctl.robot.joints import JOINT_KINDS
from hexctl.robot.messages import FloatArray
from hexctl.robot.model import Robot

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


def send_scene(stream: Any, robot: Robot, plan: TrialPlan, floor: Floor) -> None:
    """Send everything that stays as it is to a recording stream."""
    rr = load_rerun()
    stream.log(paths.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    _send_floor(stream, floor, path_end_m(robot, plan))
    _send_body(stream, robot)
    for leg in paths.LEGS:
        _send_leg(stream, robot, plan, leg)
    for path, color, radius in (
        (paths.TRAIL, style.TRAIL_COLOR, robot.foot_radius_m / 3),
        (paths.COURSE, style.COURSE_COLOR, robot.foot_radius_m / 4),
    ):
        look = rr.LineStrips3D.from_fields(colors=[color], radii=[radius])
        stream.log(path, look, static=True)
    line = rr.SeriesLines(colors=[style.DEVIATION_COLOR], names=["left of the line (m)"], widths=[2.0])
    stream.log(paths.DEVIATION, line, static=True)


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


def _send_body(stream: Any, robot: Robot) -> None:
    """Send the trunk and a mark at its front: the `ant` looks alike from all sides."""
    rr = load_rerun()
    length, width, height = robot.body.size_m
    look = {"colors": [style.BODY_COLOR], "fill_mode": "solid"}
    if robot.body.shape == "box":
        trunk = rr.Boxes3D(half_sizes=[[length / 2, width / 2, height / 2]], **look)
    else:
        trunk = rr.Cylinders3D(lengths=[height], radii=[length / 2], **look)
    stream.log(paths.BODY, trunk, static=True)
    size = 0.12 * length
    nose = rr.Boxes3D(
        centers=[[length / 2 - 1.5 * size, 0, height / 2]],
        half_sizes=[[size, size / 2, 0.1 * size]],
        colors=[style.NOSE_COLOR],
        fill_mode="solid",
    )
    stream.log(f"{paths.BODY}/front", nose, static=True)


def _send_leg(stream: Any, robot: Robot, plan: TrialPlan, leg: int) -> None:
    """Send mount, links and foot of a leg; a failed one in its own colours, a missing one as an outline."""
    rr = load_rerun()
    failure = plan.failure if plan.failure and plan.failure.leg == leg else None
    colors = style.FAILED_COLORS if failure else style.LINK_COLORS
    fill = "majorwireframe" if failure and failure.kind == "missing" else "solid"
    yaw = rr.RotationAxisAngle([0, 0, 1], radians=float(robot.mount_yaws_rad[leg - 1]))
    mount = rr.Transform3D(translation=robot.mount_positions_body[leg - 1], rotation=yaw)
    stream.log(paths.leg_path(leg), mount, static=True)
    for kind, (outward, up), radius in zip(
        JOINT_KINDS, robot.link_vectors_m, robot.link_radii_m, strict=True
    ):
        tilt = math.atan2(outward, up)  # a capsule points along z until it is turned
        solid = rr.Capsules3D(
            lengths=[math.hypot(outward, up)],
            radii=[radius],
            quaternions=[[0, math.sin(tilt / 2), 0, math.cos(tilt / 2)]],
            colors=[colors[kind]],
            fill_mode=fill,
        )
        stream.log(paths.link_path(leg, kind), solid, _series(kind), static=True)
    outward, up = robot.link_vectors_m[-1]
    label = {"labels": [f"leg {leg} {failure}"], "show_labels": True} if failure else {}
    foot = rr.Points3D([[outward, 0, up]], radii=[1.3 * robot.foot_radius_m], **label)
    stream.log(paths.foot_path(leg), foot, static=True)


def _series(kind: str) -> Any:
    """Return names and looks of a joint's two plotted angles."""
    names = [f"{kind} commanded", f"{kind} measured"]
    return load_rerun().SeriesLines(names=names, colors=style.SERIES[kind], widths=[3.0, 1.2])
