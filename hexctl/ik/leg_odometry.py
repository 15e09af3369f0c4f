"""Leg odometry: the motion of a body over the floor, and its stance, from only its joint angles.

Of the planes through three feet without a foot below, the robot stands on the one whose feet surround its
centre of mass. Feet near that plane before and after a step give the motion,

    a_i = R(yaw) b_i + shift

with a_i and b_i the positions of foot i before and after, in the levelled body frame: planar least squares
(Umeyama, 1991), with weights against outliers. A foot is a sphere that rolls: while its shin tilts outward by
an angle, its centre moves inward by the radius times that angle.
"""

from collections.abc import Collection
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from hexctl.errors import InputError
from hexctl.ik.legs import foot_positions_body, link_points_body
from hexctl.ik.support_polygon import centre_of_mass_of
from hexctl.robot.model import Robot
from hexctl.robot.rotations import levelled
from hexctl.types import N_LEGS, ArrayFields, BoolArray, FloatArray, by_leg

#: A foot this far above the standing plane has e^-1 of its weight, as a share of the stance radius.
NEAR_FLOOR = 0.01

#: Slip speed of a foot with half its weight, as a share of the stance radius per s.
SLIPPING_PER_S = 0.15

#: Minimum time between states for the slip speed: timing jitter must not make every foot slip.
LEAST_S = 0.01

#: Iterations of the weights, and with known contacts at every tick.
ROUNDS, STANCE_ROUNDS = 4, 3

#: Assumed height of the feet of missing legs, in m.
GONE_M = 1e3

#: Minimum weight, for a sum above 0.
LEAST_WEIGHT = 1e-9

#: Points of the floor as complex numbers: forward + i left, in m.
ComplexArray = NDArray[np.complex128]

_TRIPLES = np.array(list(combinations(range(N_LEGS), 3)))


@dataclass(frozen=True, slots=True, eq=False)
class Standing(ArrayFields):
    """Stance of a robot, by joint angles of any leading shape.

    Attributes:
        feet_body: centres of the feet in the body frame, leading shape + (6, 3) in m.
        above_m: of the feet over the standing plane, leading shape + (6,).
        height_m: of the body frame's origin above the floor, leading shape.
        up_body: the vertical, a unit vector in the body frame, leading shape + (3,).
    """

    feet_body: FloatArray
    above_m: FloatArray
    height_m: FloatArray
    up_body: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class LegMotions(ArrayFields):
    """Motion of a body between T moments, by its legs.

    Attributes:
        motions: in the frame of the first moment, (T - 1, 3): forward and left in m, counter-clockwise.
        height_m: of the body frame's origin above the floor, (T,).
        up_body: the vertical in the body frame, (T, 3).
    """

    motions: FloatArray
    height_m: FloatArray
    up_body: FloatArray


def standing(robot: Robot, joint_positions_rad: FloatArray, lost_legs: Collection[int] = ()) -> Standing:
    """Stance of a robot at joint angles of leading shape + (18,), without the missing legs 1..6."""
    points = link_points_body(robot, joint_positions_rad)
    feet = points[..., -1, :].copy()
    feet[..., [leg - 1 for leg in lost_legs], 2] += GONE_M
    up, below = _floor_plane(feet, centre_of_mass_of(robot, points))
    above = np.einsum("...ij,...j->...i", feet, up) - below[..., np.newaxis]
    return Standing(feet, above, robot.foot_radius_m - below, up)


def leg_motions(
    robot: Robot,
    times_s: FloatArray,
    joint_positions_rad: FloatArray,
    foot_contacts: BoolArray | None = None,
    lost_legs: Collection[int] = (),
) -> LegMotions:
    """Motion of the body from joint angles (T, 18) at ascending times (T,), T of 2 or more.

    Foot contacts are (T, 6), or derived from geometry. Raises InputError for shapes that do not fit.
    """
    times_s = np.asarray(times_s, dtype=float)
    if times_s.ndim != 1 or len(times_s) < 2 or not (np.diff(times_s) > 0).all():
        raise InputError(f"times: got {times_s.shape}; allowed: 2 or more that ascend")
    if len(joint_positions_rad) != len(times_s):
        raise InputError(f"joint angles: got {len(joint_positions_rad)}; allowed: one for each time")
    stands = standing(robot, joint_positions_rad, lost_legs)
    near = np.exp(-np.square(np.maximum(stands.above_m, 0) / (NEAR_FLOOR * robot.stance_radius_m)))
    if foot_contacts is not None:
        near = np.where(stands.above_m < GONE_M / 2, foot_contacts, 0.0)
    weights = near[:-1] * near[1:] + LEAST_WEIGHT
    # A common lean: when the supporting feet change, the plane tilts in one step, unlike a body.
    up, feet = stands.up_body[1:] + stands.up_body[:-1], stands.feet_body
    before, after = _along(feet[:-1], up), _along(feet[1:], up) + _rolled(robot, joint_positions_rad)
    slipping_m = SLIPPING_PER_S * robot.stance_radius_m * np.maximum(np.diff(times_s), LEAST_S)[:, np.newaxis]
    fit = _fit(before, after, weights, slipping_m)
    shift = fit.middle_before - fit.turn * fit.middle_after
    motions = np.stack([shift.real, shift.imag, np.angle(fit.turn)], axis=-1)
    return LegMotions(motions, stands.height_m, stands.up_body)


def stance_motions(
    robot: Robot,
    joint_positions_rad: FloatArray,
    foot_contacts: BoolArray,
    yaw_rad: FloatArray,
    period_s: float,
) -> ComplexArray:
    """Motion of the body between moments, by the feet on the floor at both, (T - 1, ...).

    Joint angles are (T, ..., 18), contacts (T, ..., 6), yaws (T, ...); the motion has the axes that the yaw
    counts from. Yaws by the feet only weigh the feet. A batch equals single robots to the last bit.
    """
    feet_body = foot_positions_body(robot, joint_positions_rad)
    feet = feet_body[..., 0] + 1j * feet_body[..., 1]
    after = feet[1:] + _rolled(robot, joint_positions_rad)
    weights = (foot_contacts[:-1] & foot_contacts[1:]).astype(float) + LEAST_WEIGHT
    slipping_m: FloatArray = np.array(SLIPPING_PER_S * robot.stance_radius_m * period_s)
    fit = _fit(feet[:-1], after, weights, slipping_m, STANCE_ROUNDS)
    turned = np.exp(1j * yaw_rad)
    return np.asarray(turned[:-1] * fit.middle_before - turned[1:] * fit.middle_after)


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Turn that maps feet back to their positions before, and weighted middles, (N, ...)."""

    middle_before: ComplexArray
    middle_after: ComplexArray
    turn: ComplexArray


def _fit(
    before: ComplexArray,
    after: ComplexArray,
    standing_weights: FloatArray,
    slipping_m: FloatArray,
    rounds: int = ROUNDS,
) -> _Fit:
    """Least squares with Cauchy weights: a foot with a residual of `slipping_m` counts half."""
    off_m: FloatArray = np.zeros(())
    for _ in range(rounds):
        weights = standing_weights / (1 + np.square(off_m / slipping_m))
        total = weights.sum(axis=-1)
        middle_before = (weights * before).sum(axis=-1) / total
        middle_after = (weights * after).sum(axis=-1) / total
        from_before = before - middle_before[..., np.newaxis]
        from_after = after - middle_after[..., np.newaxis]
        turn = (weights * from_before * from_after.conj()).sum(axis=-1)
        turn = turn / np.abs(turn)
        off_m = np.abs(from_before - turn[..., np.newaxis] * from_after)
    return _Fit(middle_before, middle_after, turn)


def _rolled(robot: Robot, joints_rad: FloatArray) -> ComplexArray:
    """Outward roll of the feet between moments in the body frame, (T - 1, ..., 6)."""
    angles = by_leg(joints_rad)
    tilted_rad = np.diff(angles[..., 1] + angles[..., 2], axis=0)
    outward = np.exp(1j * (robot.mount_yaws_rad + angles[1:, ..., 0]))
    return np.asarray(robot.foot_radius_m * tilted_rad * outward)


def _floor_plane(feet: FloatArray, centre: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Normal of the plane that feet (..., 6, 3) carry a centre of mass on, or nearly, and its distance."""
    a, b, c = (feet[..., _TRIPLES[:, corner], :] for corner in range(3))
    across = np.cross(b - a, c - a)
    sense = np.where(across[..., 2] < 0, -1.0, 1.0)
    normals = across * (sense / (np.linalg.norm(across, axis=-1) + 1e-12))[..., np.newaxis]
    offsets = (normals * a).sum(axis=-1)
    lowest = (np.einsum("...ij,...tj->...ti", feet, normals) - offsets[..., np.newaxis]).min(axis=-1)
    to_centre = centre[..., np.newaxis, :]
    inside = np.stack(
        [
            (normals * np.cross(q - p, to_centre - p)).sum(axis=-1) / np.linalg.norm(q - p, axis=-1)
            for p, q in ((a, b), (b, c), (c, a))
        ]
    )
    outside = -np.minimum((sense * inside).min(axis=0), 0)
    steep = normals[..., 2] < np.cos(np.pi / 4)
    best = (outside - 3 * lowest + 10 * steep).argmin(axis=-1)[..., np.newaxis]
    normal = np.take_along_axis(normals, best[..., np.newaxis], axis=-2)[..., 0, :]
    return normal, np.take_along_axis(offsets, best, axis=-1)[..., 0]


def _along(feet: FloatArray, up: FloatArray) -> ComplexArray:
    """Feet (..., 6, 3) along the floor, with `up` vertical."""
    flat = levelled(feet, up)
    return np.asarray(flat[..., 0] + 1j * flat[..., 1])
