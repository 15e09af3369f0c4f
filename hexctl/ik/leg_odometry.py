"""Leg odometry: the motion of a body over the floor, and its stance, from only its joint angles.

Of the planes through three feet without a foot below, the robot stands on the one whose feet surround its
centre of mass. Feet near that plane before and after a step give the motion,

    a_i = R(yaw) b_i + shift

with a_i and b_i the positions of foot i before and after, in the levelled body frame: planar least squares
(Umeyama, 1991), with weights against outliers. A foot is a sphere that rolls: while its shin tilts outward by
an angle, its centre moves inward by the radius times that angle.

Joint angles do not show a missing leg. But the body then tips onto swing feet and moves differently than its
legs predict. The path is predicted for each leg left out, and for none; a much better fit replaces the
current assumption. It serves odometry, and is no diagnosis: the best-fitting leg may not be the missing one.
"""

from collections import deque
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


#: Maximum time between two states: a gait's cycle may have passed in a longer gap.
GAP_S = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class LegStep(ArrayFields):
    """Motion of a body between two states, by its legs.

    Attributes:
        motion: in the first body frame, (3,): forward and left in m, counter-clockwise; None after a gap.
        height_m: of the body frame's origin above the floor, at the second state.
        up_body: the vertical at the second state, in the body frame, (3,).
    """

    from_s: float
    to_s: float
    motion: FloatArray | None
    height_m: float
    rise_m: float
    up_body: FloatArray


class LegOdometer:
    """Leg odometry for incoming joint angles, as `leg_motions`; `told` are known missing legs 1..6."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self.told: Collection[int] = ()
        self._watch = LostLegWatch(robot)
        self._last: tuple[float, FloatArray, BoolArray | None] | None = None

    @property
    def lost_legs(self) -> tuple[int, ...]:
        """Legs 1..6 without load: the known ones and the detected one."""
        return tuple(sorted({*self.told, *self._watch.lost_legs}))

    def update(
        self, at_s: float, joint_positions_rad: FloatArray, foot_contacts: BoolArray | None = None
    ) -> LegStep | None:
        """Motion of the body since the state before; None for the first state, an old one, and NaN angles.

        Angles are (18,), contacts (6,) where they are known; `at_s` is the time of the measurement.
        """
        last = self._last
        late = last is not None and at_s <= last[0]
        if late or not np.isfinite(joint_positions_rad).all():
            return None
        joints_rad = joint_positions_rad.copy()
        self._last = (at_s, joints_rad, foot_contacts)
        near = last is not None and at_s - last[0] < GAP_S
        if not near:
            self._watch.restart()
        if foot_contacts is None:
            self._watch.listen(at_s, joints_rad)
        if last is None:
            return None
        before_s, before_rad, touched = last
        contacts = None if touched is None or foot_contacts is None else np.stack([touched, foot_contacts])
        times_s, joints = np.array([before_s, at_s]), np.stack([before_rad, joints_rad])
        moved = leg_motions(self._robot, times_s, joints, contacts, self.lost_legs)
        before_m, after_m = moved.height_m.tolist()
        motion = moved.motions[0] if near else None
        return LegStep(before_s, at_s, motion, after_m, after_m - before_m, moved.up_body[1])

    def see(self, at_s: float, pose: FloatArray) -> None:
        """Take a pose, (3,), to detect a leg that carries nothing: x, y in m and yaw in rad, any fixed frame.

        Its time is on the clock of the states, up to a second ago.
        """
        self._watch.see(at_s, pose, self.told)


#: Time of a comparison: two cycles of a gait or more, which differ in both halves.
WINDOW_S = 3.0

#: Interval of the comparisons.
JUDGED_S = 1.0

#: Weight of the newest comparison in the running mean.
NEWEST = 0.4

#: Comparisons before the first detection.
LEAST_COMPARED = 2

#: Poses that a comparison needs.
LEAST_POSES = 10

#: A better fit has less than this share of the misfit, and is smaller by this much in m.
BETTER_SHARE, BETTER_M = 0.65, 0.003


class LostLegWatch:
    """Detects at most one lost leg, in addition to known ones. All times are on one clock."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self.lost_legs: tuple[int, ...] = ()
        self._heard: list[tuple[float, FloatArray]] = []
        self._times_s, self._motions = np.empty(0), np.empty((1 + N_LEGS, 0, 3))
        self._poses: deque[tuple[float, FloatArray]] = deque()
        self._judged_s = -np.inf
        self._misfits_m: FloatArray | None = None
        self._compared = 0

    def restart(self) -> None:
        """Forget the path until now, as after a gap; a detection stays."""
        self._heard.clear()
        self._poses.clear()
        self._times_s, self._motions = np.empty(0), np.empty((1 + N_LEGS, 0, 3))

    def listen(self, at_s: float, joint_positions_rad: FloatArray) -> None:
        """Take a state of the legs, (18,), later than the one before."""
        self._heard.append((at_s, joint_positions_rad))
        if at_s - self._heard[0][0] > WINDOW_S:  # no pose was measured meanwhile
            self.restart()

    def see(self, at_s: float, pose: FloatArray, known: Collection[int] = ()) -> None:
        """Take a pose, x and y in m and yaw in rad in any constant frame, and compare once a second."""
        if not self._heard:
            return
        self._poses.append((at_s, np.asarray(pose, dtype=float)))
        if at_s >= self._judged_s + JUDGED_S and len(self._heard) > 1:
            self._judged_s = at_s
            self._calculate(known)
            self._judge()

    def _calculate(self, known: Collection[int]) -> None:
        times_s = np.array([at_s for at_s, _ in self._heard])
        joints_rad = np.array([joints for _, joints in self._heard])
        lost = [known, *((*known, leg) for leg in range(1, N_LEGS + 1))]
        new = np.stack([leg_motions(self._robot, times_s, joints_rad, None, legs).motions for legs in lost])
        kept = self._times_s > times_s[-1] - WINDOW_S
        # Each motion with the time of its end.
        self._times_s = np.concatenate([self._times_s[kept], times_s[1:]])
        self._motions = np.concatenate([self._motions[:, kept], new], axis=1)
        self._heard = self._heard[-1:]

    def _judge(self) -> None:
        first_s, last_s = self._times_s[[0, -1]].tolist()
        while self._poses and self._poses[0][0] < first_s:
            self._poses.popleft()
        seen = [one for one in self._poses if one[0] <= last_s]
        if len(seen) < LEAST_POSES or seen[-1][0] - seen[0][0] < 0.6 * WINDOW_S:
            return
        seen_s, poses = np.array([at_s for at_s, _ in seen]), np.array([pose for _, pose in seen])
        misfits_m = np.array([self._misfit_m(motions, seen_s, poses) for motions in self._motions])
        if self._misfits_m is not None:
            misfits_m = self._misfits_m + NEWEST * (misfits_m - self._misfits_m)
        self._misfits_m, self._compared = misfits_m, self._compared + 1
        best_m, believed_m = misfits_m.min(), misfits_m[sum(self.lost_legs)]
        better = best_m < min(BETTER_SHARE * believed_m, believed_m - BETTER_M)
        if better and self._compared >= LEAST_COMPARED:
            best = int(misfits_m.argmin())
            self.lost_legs = (best,) if best else ()

    def _misfit_m(self, motions: FloatArray, seen_s: FloatArray, poses: FloatArray) -> float:
        """Median, hence robust, distance of measured poses (N, 3) from an aligned path of motions (T, 3)."""
        yaw_rad = np.cumsum(motions[:, 2])
        before_rad = yaw_rad - motions[:, 2]
        way = np.cumsum((motions[:, 0] + 1j * motions[:, 1]) * np.exp(1j * before_rad))
        way, yaw_rad = np.interp(seen_s, self._times_s, way), np.interp(seen_s, self._times_s, yaw_rad)
        turn_rad = poses[:, 2] - yaw_rad
        mean_rad = np.angle(np.exp(1j * turn_rad).sum())
        off_rad = np.angle(np.exp(1j * (turn_rad - mean_rad)))
        middle_rad = np.median(off_rad)
        off = poses[:, 0] + 1j * poses[:, 1] - np.exp(1j * (mean_rad + middle_rad)) * way
        off_m = np.abs(off - (np.median(off.real) + 1j * np.median(off.imag)))
        turn_m = self._robot.stance_radius_m * (off_rad - middle_rad)
        return float(np.median(np.hypot(off_m, turn_m)))
