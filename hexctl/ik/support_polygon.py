"""Static stability: the centre of mass, the support polygon, and the margin between them.

A pose is stable while the projected centre of mass lies within the convex hull of the feet on the floor
(paper, figure on the concept of stability). Everything is vectorised over any leading axes.
"""

from dataclasses import dataclass

import numpy as np

from hexctl.ik.legs import link_points_body
from hexctl.robot.model import Robot
from hexctl.types import JOINTS_PER_LEG, ArrayFields, BoolArray, FloatArray

#: Feet nearer to each other than this are one corner.
SAME_PLACE_M = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Support(ArrayFields):
    """A support polygon, seen from above, and the stability margin of a point.

    Attributes:
        corners: counter-clockwise, leading shape + (6, 2) in m; the last one is repeated up to six.
        margin_m: distance of the point from the nearest side, negative outside, leading shape; -inf with
            fewer than two feet on the floor.
    """

    corners: FloatArray
    margin_m: FloatArray


def centre_of_mass_body(robot: Robot, joint_positions_rad: FloatArray) -> FloatArray:
    """Centre of mass of the robot in the body frame, leading shape + (3,) in m, at angles + (18,)."""
    return centre_of_mass_of(robot, link_points_body(robot, joint_positions_rad))


def centre_of_mass_of(robot: Robot, link_points: FloatArray) -> FloatArray:
    """Centre of mass of a robot, without payload, leading shape + (3,) in m; points of `link_points_body`."""
    links = np.einsum("...lkc,k->...c", link_centres_of(robot, link_points), robot.link_masses_kg)
    trunk = robot.body.mass_kg * np.asarray(robot.body.com_m)
    return np.asarray((links + trunk) / robot.mass_kg)


def link_centres_of(robot: Robot, link_points: FloatArray) -> FloatArray:
    """Centres of mass of links, ... + (6, 3, 3) in m, from the points of `link_points_body`."""
    starts, along = link_points[..., :-1, :], np.diff(link_points, axis=-2)
    if robot.link_coms_m is None:
        return np.asarray(starts + (0.5 * robot.solid_shares)[:, np.newaxis] * along)
    # A centre is a multiple of its link's vector, and of that vector turned upward by a right angle.
    (outward, up), (com_outward, com_up) = robot.link_vectors_m.T, robot.link_coms_m.T
    square = outward**2 + up**2
    ahead = (com_outward * outward + com_up * up) / square
    beside = (com_up * outward - com_outward * up) / square
    level = along[..., :1, :2]  # a coxa points outward
    out = level / np.maximum(np.hypot(level[..., :1], level[..., 1:]), SAME_PLACE_M)
    across = (along[..., :2] * out).sum(axis=-1, keepdims=True)
    turned = np.concatenate([-along[..., 2:] * out, across], axis=-1)
    return np.asarray(starts + ahead[:, np.newaxis] * along + beside[:, np.newaxis] * turned)


def foot_heights_body(robot: Robot, joint_positions_rad: FloatArray) -> FloatArray:
    """Heights of the centres of the feet in the body frame, leading shape + (6,) in m."""
    femur, knee = joint_positions_rad[..., 1::JOINTS_PER_LEG], joint_positions_rad[..., 2::JOINTS_PER_LEG]
    (_, hip_up), (femur_out, femur_up), (tibia_out, tibia_up) = robot.link_vectors_m
    tibia = femur + knee
    up = femur_out * np.sin(femur) + femur_up * np.cos(femur)
    up += tibia_out * np.sin(tibia) + tibia_up * np.cos(tibia)
    return np.asarray(robot.mount_positions_body[:, 2] + hip_up + up)


def to_world(points_body: FloatArray, position_world: FloatArray, quaternion_world: FloatArray) -> FloatArray:
    """Points of the body frame, leading shape + (N, 3) in m, in the world frame.

    With the quaternion (w, q), which is (w, x, y, z), leading shape + (4,), and the position in m:
    p_world = position + p + 2 w (q x p) + 2 q x (q x p).
    """
    w, axis = quaternion_world[..., np.newaxis, :1], quaternion_world[..., np.newaxis, 1:]
    twice = 2 * np.cross(axis, points_body)
    return np.asarray(position_world[..., np.newaxis, :] + points_body + w * twice + np.cross(axis, twice))


def carried(feet: FloatArray, standing: BoolArray, point: FloatArray) -> BoolArray:
    """Whether a point is within the convex hull of the standing feet; faster than `support`."""
    toward = feet - point[..., np.newaxis, :]
    angles = np.arctan2(toward[..., 1], toward[..., 0])
    # A foot in the air takes the direction of one on the floor, which leaves the gaps unchanged.
    first = np.where(standing, angles, np.pi).min(axis=-1, keepdims=True)
    angles = np.sort(np.where(standing, angles, first), axis=-1)
    gaps = np.diff(angles, axis=-1, append=angles[..., :1] + 2 * np.pi)
    return np.asarray(standing.any(axis=-1) & (gaps < np.pi).all(axis=-1))


def support(feet: FloatArray, standing: BoolArray, point: FloatArray) -> Support:
    """Convex hull of the feet on the floor and the margin of a point, all seen from above.

    Args:
        feet: leading shape + (6, 2) in m.
        standing: which feet are on the floor, leading shape + (6,).
        point: the projected centre of gravity, leading shape + (2,).
    """
    outer, sides, lengths = _sides(feet, standing)
    to_point = (point[..., np.newaxis, :] - feet)[..., np.newaxis, :]  # (..., from, 1, 2)
    distance = _cross(sides, to_point) / np.maximum(lengths, SAME_PLACE_M)
    margin = np.where(outer, distance, np.inf).min(axis=(-2, -1))
    return Support(_corners(feet, standing, outer), np.where(np.isposinf(margin), -np.inf, margin))


def margins_at_m(feet: FloatArray, standing: BoolArray, points: FloatArray) -> FloatArray:
    """Stability margins in m of points, (points, 2) in m, over the same feet; faster than `support`.

    Feet are leading shape + (6, 2) in m, `standing` leading shape + (6,), margins (points,) + leading shape.
    """
    outer, sides, lengths = _sides(feet, standing)
    lengths = np.maximum(lengths, SAME_PLACE_M)
    # The distance of a point from a side is linear in it: from the origin, less the point along the normal.
    constant = np.where(outer, _cross(sides, -feet[..., np.newaxis, :]) / lengths, np.inf)
    normals = np.where(outer[..., np.newaxis], sides / lengths[..., np.newaxis], 0.0)
    rows = [
        (constant + _cross(normals, point)).min(axis=(-2, -1)) for point in points[:, np.newaxis, np.newaxis]
    ]
    margins_m = np.array(rows)
    return np.where(np.isposinf(margins_m), -np.inf, margins_m)


def _sides(feet: FloatArray, standing: BoolArray) -> tuple[BoolArray, FloatArray, FloatArray]:
    """Lines between two feet: which are sides of the hull, as vectors, and their lengths, (..., from, to)."""
    # The cross product of two feet, seen from a third, is a sum of their products seen from the origin.
    seen = feet - feet[..., :1, :]
    products = _cross(seen[..., :, np.newaxis, :], seen[..., np.newaxis, :, :])  # (..., from, to)
    left = products[..., np.newaxis] + products[..., np.newaxis, :, :]  # (..., from, to, foot)
    left -= products[..., :, np.newaxis, :]
    sides = seen[..., np.newaxis, :, :] - seen[..., :, np.newaxis, :]  # (..., from, to, 2)
    lengths = np.hypot(sides[..., 0], sides[..., 1])
    right_of = left < -SAME_PLACE_M * lengths[..., np.newaxis]
    outer = ~(right_of & standing[..., np.newaxis, np.newaxis, :]).any(axis=-1)
    outer &= standing[..., :, np.newaxis] & standing[..., np.newaxis, :] & (lengths > SAME_PLACE_M)
    return outer, sides, lengths


def _corners(feet: FloatArray, standing: BoolArray, outer: BoolArray) -> FloatArray:
    """Feet at which the sides begin, in order around their middle; without a side, all standing feet."""
    corner = outer.any(axis=-1)
    corner = np.where(corner.any(axis=-1, keepdims=True), corner, standing)
    count = corner.sum(axis=-1, keepdims=True)
    middle = np.where(corner[..., np.newaxis], feet, 0.0).sum(axis=-2) / np.maximum(count, 1)
    around = feet - middle[..., np.newaxis, :]
    angles = np.where(corner, np.arctan2(around[..., 1], around[..., 0]), np.inf)
    rank = np.minimum(np.arange(corner.shape[-1]), np.maximum(count - 1, 0))
    order = np.take_along_axis(np.argsort(angles, axis=-1), rank, axis=-1)
    return np.take_along_axis(feet, order[..., np.newaxis], axis=-2)


def _cross(first: FloatArray, second: FloatArray) -> FloatArray:
    """Z component of cross products in the plane, positive if the second vector is on the left."""
    return np.asarray(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])
