"""The robot's parts as they are drawn: meshes where its file names some, else solids of its own geometry."""

import math
from typing import Any

from hexctl.control.plan import TrialPlan
from hexctl.record import paths, style
from hexctl.record.sdk import load_rerun
from hexctl.robot.failure import Failure
from hexctl.robot.meshes import Meshes, PartMesh
from hexctl.robot.model import Robot
from hexctl.types import JOINT_KINDS


def send_body(stream: Any, robot: Robot, meshes: Meshes) -> None:
    """Send the trunk and a mark at its front: the `ant` looks alike from all sides."""
    rr = load_rerun()
    if "body" in meshes:
        stream.log(paths.BODY, *_asset(meshes["body"], style.BODY_COLOR), static=True)
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


def send_leg(stream: Any, robot: Robot, plan: TrialPlan, meshes: Meshes, leg: int) -> None:
    """Send mount, links and foot of a leg; a failed one in its own colours, a missing one as an outline."""
    rr = load_rerun()
    failure = plan.failure if plan.failure and plan.failure.leg == leg else None
    yaw = rr.RotationAxisAngle([0, 0, 1], radians=float(robot.mount_yaws_rad[leg - 1]))
    mount = rr.Transform3D(translation=robot.mount_positions_body[leg - 1], rotation=yaw)
    stream.log(paths.leg_path(leg), mount, static=True)
    start = (0.0, 0.0)
    for index, kind in enumerate(JOINT_KINDS):
        if index:
            joint = rr.Transform3D(translation=[start[0], 0.0, start[1]])
            stream.log(paths.joint_path(leg, kind), joint, static=True)
        parts = _link(robot, index, failure, meshes)
        stream.log(paths.link_path(leg, kind), *parts, _series(kind), static=True)
        start = tuple(robot.link_vectors_m[index])
    label = {"labels": [f"leg {leg} {failure}"], "show_labels": True} if failure else {}
    foot = rr.Points3D([[start[0], 0, start[1]]], radii=[1.3 * robot.foot_radius_m], **label)
    stream.log(paths.foot_path(leg), foot, static=True)


def _trunk(robot: Robot) -> Any:
    """Return the solid of the trunk."""
    rr = load_rerun()
    length, width, height = robot.body.size_m
    look = {"colors": [style.BODY_COLOR], "fill_mode": "solid"}
    if robot.body.shape == "box":
        return rr.Boxes3D(half_sizes=[[length / 2, width / 2, height / 2]], **look)
    return rr.Cylinders3D(lengths=[height], radii=[length / 2], **look)


def _link(robot: Robot, index: int, failure: Failure | None, meshes: Meshes) -> list[Any]:
    """Return what a link is drawn as."""
    kind = JOINT_KINDS[index]
    color = (style.FAILED_COLORS if failure else style.LINK_COLORS)[kind]
    missing = failure is not None and failure.kind == "missing"
    # An outline says that a leg is not there; a mesh has none.
    if kind in meshes and not missing:
        return _asset(meshes[kind], color, tinted=failure is not None)
    outward, up = robot.link_vectors_m[index]
    tilt = math.atan2(outward, up)  # a capsule points along z until it is turned
    capsule = load_rerun().Capsules3D(
        lengths=[math.hypot(outward, up)],
        radii=[robot.link_radii_m[index]],
        quaternions=[[0, math.sin(tilt / 2), 0, math.cos(tilt / 2)]],
        colors=[color],
        fill_mode="majorwireframe" if missing else "solid",
    )
    return [capsule]


def _asset(mesh: PartMesh, color: style.Color, *, tinted: bool = False) -> list[Any]:
    """Return a mesh in its place; it is tinted where asked for, or where it brings no colours."""
    rr = load_rerun()
    w, x, y, z = mesh.quaternion.tolist()
    pose = rr.InstancePoses3D(
        translations=[mesh.position_m], quaternions=[[x, y, z, w]], scales=[[mesh.scale] * 3]
    )
    look = {"albedo_factor": color} if tinted or not mesh.coloured else {}
    return [rr.Asset3D(contents=mesh.content, media_type=mesh.media_type, **look), pose]


def _series(kind: str) -> Any:
    """Return names and looks of a joint's two plotted angles."""
    names = [f"{kind} commanded", f"{kind} measured"]
    return load_rerun().SeriesLines(names=names, colors=style.SERIES[kind], widths=[3.0, 1.2])
