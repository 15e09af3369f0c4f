"""Clearance between neighbouring legs: the minimum gap between links and feet as capsules and spheres."""

from dataclasses import dataclass

import numpy as np

from hexctl.ik.legs import link_points_body
from hexctl.robot.model import Robot
from hexctl.types import ArrayFields, FloatArray

#: Parts of a leg whose gaps are measured.
PARTS = ("coxa", "femur", "tibia", "foot")

#: Square of a length below which a segment is a point.
POINT_M2 = 1e-18


@dataclass(frozen=True, slots=True, eq=False)
class LegClearance(ArrayFields):
    """Gaps between each leg and the next one, leg 1 and 2 first, leg 6 and 1 last; leading shape + (6,).

    Attributes:
        gaps_m: gap between the nearest two parts, negative if they overlap.
        depths: their overlap as a share of the sum of their radii, 1 if their axes meet.
        nearest: their indices in `PARTS`: deepest overlap, or else smallest gap, leading shape + (6, 2).
    """

    gaps_m: FloatArray
    depths: FloatArray
    nearest: FloatArray


def leg_clearance(robot: Robot, joint_positions_rad: FloatArray) -> LegClearance:
    """Gaps between neighbouring legs at joint angles of leading shape + (18,)."""
    points = link_points_body(robot, joint_positions_rad)  # (..., 6, 4, 3)
    starts, ends = points, np.concatenate([points[..., 1:, :], points[..., -1:, :]], axis=-2)
    radii = np.append(robot.link_radii_m, robot.foot_radius_m)
    other_starts, other_ends = np.roll(starts, -1, axis=-3), np.roll(ends, -1, axis=-3)
    between = segment_distance_m(
        starts[..., :, np.newaxis, :],
        ends[..., :, np.newaxis, :],
        other_starts[..., np.newaxis, :, :],
        other_ends[..., np.newaxis, :, :],
    )  # (..., 6, 4, 4)
    touching = radii[:, np.newaxis] + radii
    gaps = (between - touching).reshape(*between.shape[:-2], -1)
    depths = np.maximum(0.0, 1 - between / touching).reshape(gaps.shape)
    pair = nearness(gaps, depths).argmin(axis=-1)[..., np.newaxis]
    gaps_m, depths = (np.take_along_axis(values, pair, -1)[..., 0] for values in (gaps, depths))
    return LegClearance(gaps_m, depths, np.stack(np.divmod(pair[..., 0], len(PARTS)), axis=-1))


def nearness(gaps_m: FloatArray, depths: FloatArray) -> FloatArray:
    """Sort key of pairs, the nearest first: by depth if they overlap, else by gap."""
    return np.where(depths > 0, -depths, gaps_m)


def segment_distance_m(
    start: FloatArray, end: FloatArray, other_start: FloatArray, other_end: FloatArray
) -> FloatArray:
    """Minimum distance between segments (Ericson, Real-Time Collision Detection, 2005, section 5.1.9)."""
    along, other = end - start, other_end - other_start
    between = start - other_start
    a, e = _dot(along, along), _dot(other, other)
    b, c, f = _dot(along, other), _dot(along, between), _dot(other, between)
    parallel = a * e - b**2
    s = np.where(parallel > POINT_M2**2, (b * f - c * e) / np.maximum(parallel, POINT_M2**2), 0.0)
    s = np.clip(s, 0.0, 1.0)
    t = np.clip((b * s + f) / np.maximum(e, POINT_M2), 0.0, 1.0)
    s = np.clip((b * t - c) / np.maximum(a, POINT_M2), 0.0, 1.0)
    gap = between + s[..., np.newaxis] * along - t[..., np.newaxis] * other
    return np.asarray(np.sqrt(_dot(gap, gap)))


def _dot(one: FloatArray, other: FloatArray) -> FloatArray:
    return np.asarray((one * other).sum(axis=-1))
