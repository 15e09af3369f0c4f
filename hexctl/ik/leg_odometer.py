"""Leg odometry for incoming states, with detection of a leg that carries nothing.

Joint angles do not show a missing leg. But the body then tips onto swing feet and moves differently than its
legs predict. The path is predicted for each leg left out, and for none; a much better fit replaces the
current assumption. It serves odometry, and is no diagnosis: the best-fitting leg may not be the missing one.
"""

from collections import deque
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from hexctl.ik.leg_odometry import leg_motions
from hexctl.robot.model import Robot
from hexctl.types import N_LEGS, ArrayFields, BoolArray, FloatArray

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
    """Leg odometry for incoming joint angles, as `leg_motions`; `known_lost_legs` are 1..6."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self.known_lost_legs: Collection[int] = ()
        self._watch = LostLegWatch(robot)
        self._last: tuple[float, FloatArray, BoolArray | None] | None = None

    @property
    def lost_legs(self) -> tuple[int, ...]:
        """Legs 1..6 without load: the known ones and the detected one."""
        return tuple(sorted({*self.known_lost_legs, *self._watch.lost_legs}))

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
        self._watch.see(at_s, pose, self.known_lost_legs)


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
