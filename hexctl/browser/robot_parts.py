"""The parts of a robot as triangles, and their poses in the body frame: one shape for each kind of link."""

import io
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from hexctl.ik.legs import link_points_body
from hexctl.robot.meshes import PartMesh
from hexctl.robot.model import Robot
from hexctl.robot.rotations import matrix_of
from hexctl.types import N_LEGS, FloatArray, by_leg

#: Sides of round solids: enough to look round, few enough to draw without a graphics card.
SIDES = 12

FILE_TYPES = {"model/stl": "stl", "model/obj": "obj", "model/gltf-binary": "glb"}


@dataclass(frozen=True, eq=False)
class Shape:
    """Vertices (n, 3) in m, and triangles of their indices, (m, 3)."""

    vertices_m: FloatArray
    triangles: Any


@dataclass(frozen=True, eq=False)
class LegPoses:
    """Poses of all links in the body frame.

    Attributes:
        joints_m: where links begin, (6, 3, 3).
        quaternions: of links (w, x, y, z): x outward and z up at angle zero, (6, 3, 4).
        feet_m: (6, 3).
    """

    joints_m: FloatArray
    quaternions: FloatArray
    feet_m: FloatArray


def leg_poses(robot: Robot, joint_positions_rad: FloatArray) -> LegPoses:
    """Poses of the links at joint angles, (18,)."""
    points_m = link_points_body(robot, joint_positions_rad)
    angles = by_leg(joint_positions_rad)
    yaw = (robot.mount_yaws_rad + angles[:, 0])[:, np.newaxis] / 2
    pitch = np.stack([np.zeros(N_LEGS), angles[:, 1], angles[:, 1] + angles[:, 2]], axis=-1) / 2
    cos_yaw, sin_yaw, cos, sin = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    # A turn about z after one about -y, which lifts.
    quaternions = np.stack([cos_yaw * cos, sin_yaw * sin, -cos_yaw * sin, sin_yaw * cos], axis=-1)
    return LegPoses(points_m[:, :3], quaternions, points_m[:, 3])


def link_shape(robot: Robot, link: int, mesh: PartMesh | None) -> Shape:
    """Shape of link 0..2 of every leg in its own frame: its mesh, or a capsule."""
    if mesh is not None:
        return _file_shape(mesh)
    import trimesh

    outward, up = robot.link_vectors_m[link]
    length_m = math.hypot(outward, up)
    solid = trimesh.creation.capsule(length_m, robot.link_radii_m[link], count=[SIDES, SIDES])
    solid.apply_translation([0, 0, length_m / 2 - solid.bounds.mean(axis=0)[2]])  # along z from the joint on
    turn = trimesh.transformations.rotation_matrix(math.atan2(outward, up), [0, 1, 0])
    return _shape_of(solid.apply_transform(turn))


def trunk_shape(robot: Robot, mesh: PartMesh | None) -> Shape:
    """Shape of the trunk in the body frame."""
    if mesh is not None:
        return _file_shape(mesh)
    import trimesh

    length, width, height = robot.body.size_m
    if robot.body.shape == "box":
        return _shape_of(trimesh.creation.box((length, width, height)))
    return _shape_of(trimesh.creation.cylinder(length / 2, height, sections=3 * SIDES))


def nose_shape(robot: Robot) -> Shape:
    """A mark at the front of the trunk, because some robots are symmetric."""
    import trimesh

    length, _, height = robot.body.size_m
    size = 0.12 * length
    nose = trimesh.creation.box((2 * size, size, 0.2 * size))
    return _shape_of(nose.apply_translation((length / 2 - 1.5 * size, 0, height / 2)))


def foot_shape(robot: Robot) -> Shape:
    """A foot around its centre, a little larger than in the physics, which makes contacts visible."""
    import trimesh

    return _shape_of(trimesh.creation.uv_sphere(1.3 * robot.foot_radius_m, count=[SIDES // 2, SIDES]))


def _file_shape(mesh: PartMesh) -> Shape:
    import trimesh

    kind = FILE_TYPES[mesh.media_type]
    solid = trimesh.load(io.BytesIO(mesh.content), file_type=kind, force="mesh", process=False)
    vertices_m = mesh.scale * np.asarray(solid.vertices) @ matrix_of(mesh.quaternion).T + mesh.position_m
    return Shape(vertices_m, np.asarray(solid.faces))


def _shape_of(solid: Any) -> Shape:
    return Shape(np.asarray(solid.vertices), np.asarray(solid.faces))
