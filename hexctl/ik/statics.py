"""Statics of a standing robot: weight on each foot, deflection of each joint, sag of the body.

Servos hold their targets as springs of stiffness k. The force f_i on foot i pushes each of its joints up by
f_i r_j, with r_j the horizontal distance from joint to foot, and the links' weight pulls it down by g_j. Dry
friction is omitted. A joint deflects by

    d_j = (f_i r_j - g_j) / k_j,    holding the torque -k_j d_j,

and the foot yields by the sum of r_j d_j. Feet slide without friction, because every step sets them down
unloaded. The body pose, height and two tilts, is the one at which all forces f_i >= 0 balance the weight and
its two moments.
"""

from dataclasses import dataclass

import numpy as np

from hexctl.ik.legs import link_points_body
from hexctl.ik.support_polygon import centre_of_mass_of, link_centres_of
from hexctl.robot.model import Robot
from hexctl.types import GRAVITY_M_S2, JOINTS_PER_LEG, ArrayFields, BoolArray, FloatArray, by_leg

#: Passes over the geometry, each at the deflected pose of the one before.
PASSES = 4

#: Maximum number of changes of the set of pressing feet.
ROUNDS = 20

#: Stiffness of a virtual support of the body for fewer than three pressing feet: N/m upward, N m per unit of
#: slope. It makes the equations regular; on it a robot sinks by kilometres, and does not balance.
SUPPORT = np.diag([1e-3, 1e-5, 1e-5])

#: Motion of a foot in a step of the body pose that counts as none.
TINY_M = 1e-15

#: Deflection beyond which the geometry of a pass is not trusted.
MAX_DEFLECTION_RAD = 1.0

#: Imbalance of the forces, as a share of the weight, that still counts as balanced.
BALANCE = 0.01

#: Minimum compliance of a leg, m/N: a leg with the foot straight below its joints does not yield.
LEAST_COMPLIANCE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class StaticLoad(ArrayFields):
    """A robot at rest under its weight.

    Attributes:
        torques_nm: held by the servos, positive as their angles, leading shape + (18,).
        deflections_rad: joint angles less their targets, leading shape + (18,).
        foot_forces_n: upward forces on the feet, leading shape + (6,).
        foot_heights_m: over the floor, leading shape + (6,).
        sag_m: of the body frame relative to rigid servos, leading shape.
        balanced: whether forces and weight balance, leading shape; otherwise the robot tips over, and the
            other values are invalid.
    """

    torques_nm: FloatArray
    deflections_rad: FloatArray
    foot_forces_n: FloatArray
    foot_heights_m: FloatArray
    sag_m: FloatArray
    balanced: BoolArray


def static_load(robot: Robot, joint_targets_rad: FloatArray) -> StaticLoad:
    """Load of a robot on an even floor whose servos hold targets, leading shape + (18,), at any torque."""
    stiffness = by_leg(robot.stiffness_nm_per_rad)
    targets = by_leg(joint_targets_rad)
    joints, level_m = targets, np.zeros(targets.shape[:-2])
    for number in range(PASSES):
        points = link_points_body(robot, joints.reshape(joint_targets_rad.shape))
        arms = arms_m(robot, points, joints)
        weights = link_torques_nm(robot, arms)
        reach = arms[..., -1, :]  # joint to foot, (..., 6, 3)
        compliance = np.maximum((reach**2 / stiffness).sum(axis=-1), LEAST_COMPLIANCE)
        rest_m = points[..., -1, 2] + (reach * (targets - joints - weights / stiffness)).sum(axis=-1)
        if number == 0:
            level_m = points[..., -1, 2].min(axis=-1)
        centre = centre_of_mass_of(robot, points)
        body, forces = _balance(robot.mass_kg, points[..., -1, :2], rest_m, compliance, centre)
        deflections = (forces[..., np.newaxis] * reach - weights) / stiffness
        joints = targets + np.clip(deflections, -MAX_DEFLECTION_RAD, MAX_DEFLECTION_RAD)
    heights = _plane(body, points[..., -1, :2]) + rest_m + compliance * forces
    return StaticLoad(
        torques_nm=(-stiffness * deflections).reshape(joint_targets_rad.shape),
        deflections_rad=deflections.reshape(joint_targets_rad.shape),
        foot_forces_n=forces,
        foot_heights_m=np.maximum(heights, 0.0),
        sag_m=-(body[..., 0] + level_m),
        balanced=_balanced(robot, points[..., -1, :2], forces, centre),
    )


def _balanced(robot: Robot, feet: FloatArray, forces: FloatArray, centre: FloatArray) -> BoolArray:
    levers = feet - centre[..., np.newaxis, :2]
    moments = np.abs((forces[..., np.newaxis] * levers).sum(axis=-2)).max(axis=-1)
    weight_n = GRAVITY_M_S2 * robot.mass_kg
    off = np.maximum(np.abs(forces.sum(axis=-1) - weight_n), moments / robot.stance_radius_m)
    return np.asarray(off < BALANCE * weight_n)


def arms_m(robot: Robot, points: FloatArray, joints: FloatArray) -> FloatArray:
    """Distances outward in the leg plane from each joint to link centres and foot, (..., 6, 4, 3).

    Row l of the four is the centre of mass of link l, the last row the foot. Coxae have none; a joint has
    none to the links before it.
    """
    azimuth = (robot.mount_yaws_rad + joints[..., 0])[..., np.newaxis]

    def outward(places: FloatArray) -> FloatArray:
        return np.asarray(places[..., 0] * np.cos(azimuth) + places[..., 1] * np.sin(azimuth))

    starts = outward(points[..., :-1, :])
    rows = np.concatenate([outward(link_centres_of(robot, points)), outward(points[..., -1:, :])], axis=-1)
    arms = rows[..., :, np.newaxis] - starts[..., np.newaxis, :]
    carried = np.arange(JOINTS_PER_LEG + 1)[:, np.newaxis] >= np.arange(JOINTS_PER_LEG)
    carried[:, 0] = False
    return np.where(carried, arms, 0.0)


def link_torques_nm(robot: Robot, arms: FloatArray) -> FloatArray:
    """Torques with which the links' weight pulls the joints down, (..., 6, 3)."""
    return np.asarray(GRAVITY_M_S2 * np.einsum("...lj,l->...j", arms[..., :-1, :], robot.link_masses_kg))


def _plane(body: FloatArray, feet: FloatArray) -> FloatArray:
    """Height that a body pose (height, slope along x, along y) gives to points (..., 6, 2)."""
    return np.asarray(body[..., :1] + (body[..., np.newaxis, 1:] * feet).sum(axis=-1))


def _balance(
    mass_kg: float, feet: FloatArray, rest_m: FloatArray, compliance: FloatArray, centre: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Body pose (..., 3) and foot forces (..., 6) that carry a mass; Newton's method over which feet press.

    The energy of springs under a plate is convex: the set of pressing feet is unique. Full steps may cycle
    between two sets; a line search does not.
    """
    weight_n = GRAVITY_M_S2 * mass_kg
    columns = np.concatenate([np.ones_like(feet[..., :1]), feet], axis=-1)  # (..., 6, 3)
    load = weight_n * np.concatenate([np.ones_like(centre[..., :1]), centre[..., :2]], axis=-1)
    plate = _Plate(columns, 1 / compliance, rest_m, load)
    body = plate.rest(np.ones(rest_m.shape, dtype=bool))
    for _ in range(ROUNDS):
        pressing = plate.gaps_m(body) < 0
        step = plate.rest(pressing) - body
        body = body + plate.least(body, step)[..., np.newaxis] * step
        if ((plate.gaps_m(body) < 0) == pressing).all():
            break
    return body, np.maximum(0.0, -plate.gaps_m(body) / compliance)


@dataclass(frozen=True, slots=True, eq=False)
class _Plate:
    """The body as a plate under a load, on one spring for each foot that only pushes.

    Attributes:
        columns: 1, x and y of each foot, (..., 6, 3).
        stiffness: of the springs in N/m, (..., 6).
        rest_m: heights of the feet over the plate without force, (..., 6).
        load: the weight, N, and its moments, N m, (..., 3).
    """

    columns: FloatArray
    stiffness: FloatArray
    rest_m: FloatArray
    load: FloatArray

    def gaps_m(self, body: FloatArray) -> FloatArray:
        """Heights of unloaded feet over the floor (..., 6), negative if a foot presses."""
        return np.asarray(np.einsum("...ia,...a->...i", self.columns, body) + self.rest_m)

    def rest(self, pressing: BoolArray) -> FloatArray:
        """Pose in equilibrium on springs at these feet; a robot that tips over has a huge one."""
        pressed = np.where(pressing, self.stiffness, 0.0)
        matrix = np.einsum("...ia,...i,...ib->...ab", self.columns, pressed, self.columns) + SUPPORT
        pull = self.load + np.einsum("...ia,...i,...i->...a", self.columns, pressed, self.rest_m)
        return np.asarray(-np.linalg.solve(matrix, pull[..., np.newaxis])[..., 0])

    def least(self, body: FloatArray, step: FloatArray) -> FloatArray:
        """Share 0..1 of a step with the least energy, leading shape.

        The slope of the energy along the step is piecewise linear, with a bend at each foot that meets or
        leaves the floor.
        """
        start = self.gaps_m(body)
        change = np.einsum("...ia,...a->...i", self.columns, step)
        moving = np.abs(change) > TINY_M
        meets = np.where(moving, -start / np.where(moving, change, 1.0), 0.0)
        ends = np.zeros_like(start[..., :1])
        shares = np.sort(np.concatenate([ends, np.clip(meets, 0.0, 1.0), ends + 1.0], axis=-1), axis=-1)
        slopes = self._slopes(body, step, shares)
        after = np.clip((slopes < 0).sum(axis=-1, keepdims=True), 1, shares.shape[-1] - 1)
        low, high = (np.take_along_axis(slopes, index, -1)[..., 0] for index in (after - 1, after))
        begin, end = (np.take_along_axis(shares, index, -1)[..., 0] for index in (after - 1, after))
        rising = high > low
        share = begin - low * (end - begin) / np.where(rising, high - low, 1.0)
        return np.asarray(np.clip(np.where(rising, share, end), begin, end))

    def _slopes(self, body: FloatArray, step: FloatArray, shares: FloatArray) -> FloatArray:
        """Derivatives of the energy along a step at shares of it, the shape of the shares."""
        poses = body[..., np.newaxis, :] + shares[..., np.newaxis] * step[..., np.newaxis, :]
        gaps = np.einsum("...ia,...sa->...si", self.columns, poses) + self.rest_m[..., np.newaxis, :]
        pushes = self.stiffness[..., np.newaxis, :] * np.minimum(gaps, 0.0)
        pull = np.einsum("...si,...ia->...sa", pushes, self.columns) + poses @ SUPPORT
        return np.asarray(((pull + self.load[..., np.newaxis, :]) * step[..., np.newaxis, :]).sum(axis=-1))
