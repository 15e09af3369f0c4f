"""Load capacity: how many times its own weight a robot carries on some of its feet, as a limit analysis.

A servo at its torque limit yields, and the weight moves to legs with torque left. The robot stands as long as
any distribution of foot forces balances the weight within all limits. Two steps:

- The most that leg i carries, F_i: the largest upward force f with an outward force h, |h| <= mu f, for
  which femur and tibia hold |g_j - f r_j + h z_j| <= torque limit + dry friction (r_j outward, z_j up from
  the joint to the foot, g_j the links' own weight). Outward forces of opposite legs balance each other.
- The weight W at the centre of mass first falls about some line through two feet. By the duality of linear
  programming the capacity is the minimum over these lines, with d the distances from the line:

      sum over feet on its side of F_k d_k / (W d_centre).
"""

from itertools import combinations

import numpy as np

from hexctl.ik.legs import link_points_body
from hexctl.ik.statics import arms_m, link_torques_nm
from hexctl.ik.support_polygon import centre_of_mass_of
from hexctl.robot.model import Robot
from hexctl.types import GRAVITY_M_S2, N_LEGS, BoolArray, FloatArray, by_leg

#: Determinants and distances below this are zero.
TINY = 1e-12


def load_capacity(
    robot: Robot, joint_positions_rad: FloatArray, standing: BoolArray, *, friction: float
) -> FloatArray:
    """Multiples of its weight that a robot carries, leading shape; below 1 it sinks, 0 if it tips over."""
    points = link_points_body(robot, joint_positions_rad)
    forces = np.where(standing, _leg_capacity_n(robot, joint_positions_rad, points, friction), 0.0)
    feet, centre = points[..., -1, :2], centre_of_mass_of(robot, points)[..., :2]
    weight_n = GRAVITY_M_S2 * robot.mass_kg
    capacity = forces.sum(axis=-1) / weight_n
    for one, other in combinations(range(N_LEGS), 2):
        along = feet[..., other, :] - feet[..., one, :]
        across = np.stack([-along[..., 1], along[..., 0]], axis=-1)
        feet_m = ((feet - feet[..., one : one + 1, :]) * across[..., np.newaxis, :]).sum(axis=-1)
        centre_m = ((centre - feet[..., one, :]) * across).sum(axis=-1)
        side = np.sign(centre_m)[..., np.newaxis]
        carried = (forces * np.maximum(0.0, side * feet_m)).sum(axis=-1)
        lever = np.abs(centre_m)
        share = carried / (np.where(lever > TINY, lever, 1.0) * weight_n)
        capacity = np.where(lever > TINY, np.minimum(capacity, share), capacity)
    return np.asarray(capacity)


def _leg_capacity_n(
    robot: Robot, joint_positions_rad: FloatArray, points: FloatArray, friction: float
) -> FloatArray:
    """The most that each leg carries, (..., 6): a linear program in (f, h), solved at its corners."""
    arms = arms_m(robot, points, by_leg(joint_positions_rad))
    outward = arms[..., -1, 1:]
    up = points[..., -1:, 2] - points[..., 1:-1, 2]
    own = link_torques_nm(robot, arms)[..., 1:]
    limit = by_leg(robot.joint_max_torque_nm + robot.dry_friction_nm)[:, 1:]
    ones = np.ones_like(outward[..., :1])
    # a f + b h <= c: both joints to either side, and the two sides of the friction cone.
    a = np.concatenate([-outward, outward, -friction * ones, -friction * ones], axis=-1)
    b = np.concatenate([up, -up, ones, -ones], axis=-1)
    c = np.concatenate([limit - own, limit + own, 0 * ones, 0 * ones], axis=-1)
    best = np.zeros(outward.shape[:-1])
    for i, k in combinations(range(a.shape[-1]), 2):
        determinant = a[..., i] * b[..., k] - a[..., k] * b[..., i]
        corner = np.abs(determinant) > TINY
        scale = np.where(corner, determinant, 1.0)
        f = (c[..., i] * b[..., k] - c[..., k] * b[..., i]) / scale
        h = (a[..., i] * c[..., k] - a[..., k] * c[..., i]) / scale
        slack = c - a * f[..., np.newaxis] - b * h[..., np.newaxis]
        allowed = corner & (slack >= -1e-9 * (1 + np.abs(c))).all(axis=-1)
        best = np.where(allowed, np.maximum(best, f), best)
    return best
