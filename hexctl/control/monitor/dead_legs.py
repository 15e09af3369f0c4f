"""Dead legs, compared with the other legs and with the commanded motion: a habit is not needed.

A leg dead before the first step has no other habit, and neither has the second of two legs
lost together. Two signs need no habit:

- A leg gives no torque in any of its joints for most of a cycle, while the other legs do: limp or missing.
- In the first cycle its joints do not move with their targets: locked or limp. With sums over its joints,

      gain = sum cov(measured, target) / sum var(target)

  it is near 1 for a leg that follows, near 0 for one that does not. Without torques, a foot without
  contact since the start is missing.
"""

import math

import numpy as np

from hexctl.control.monitor.joint_following import JointFollowing
from hexctl.robot.failure import Failure
from hexctl.types import JOINTS_PER_LEG, N_LEGS, BoolArray, FloatArray, RobotState, by_leg

#: Time without torque after which a leg is dead, in s and in cycles.
IDLE_S, IDLE_CYCLES = 1.0, 0.6

#: Time without torque of a leg that does not follow, from which it is limp and not locked.
LIMP_S = 0.1

#: Gain below which a leg does not follow, as a share of the median leg's, and the root of the summed
#: variances of its targets from which it counts.
LEAST_GAIN, LEAST_SPREAD_RAD = 0.15, math.radians(6.5)

#: Gain of the median leg of a robot whose legs follow, and of a leg without torque that does: it is missing.
LEAST_USUAL, FOLLOWS_GAIN = 0.5, 0.5

#: How long the start lasts, in s and in cycles, and when a foot must have touched the floor.
FIRST_S, FIRST_CYCLES, TOUCHED_S = 3.0, 1.5, 2.5


class DeadLegs:
    """Evidence of dead legs, tick by tick; `cycles` of one tick have the leading shape.

    Attributes:
        idle: time without torque of each leg over its limit, leading shape + (6,).
        start: evidence from the first cycle, an alarm at 1, leading shape + (6,).
        follows: whether each leg followed its targets at the start, leading shape + (6,).
    """

    def __init__(self, shape: tuple[int, ...], period_s: float, cycles: FloatArray) -> None:
        legs = (*shape, N_LEGS)
        self._shape, self._period_s, cycle_s = shape, period_s, period_s / np.asarray(cycles)[..., np.newaxis]
        self._idle_s: FloatArray = np.zeros(legs)
        self._most_idle_s = np.maximum(IDLE_S, IDLE_CYCLES * cycle_s)
        self._first_s = np.maximum(FIRST_S, FIRST_CYCLES * cycle_s)
        self._lasts_s = float(self._first_s.max())
        self._walked_s, self._count = 0.0, 0
        self._origin: tuple[FloatArray, FloatArray] | None = None
        self._sums: FloatArray = np.zeros((4, *shape, N_LEGS * JOINTS_PER_LEG))
        self._touched: BoolArray = np.zeros(legs, dtype=bool)
        self._counts, self._starts = False, True
        self.follows: BoolArray = np.ones(legs, dtype=bool)
        self.idle: FloatArray = np.zeros(legs)
        self.start: FloatArray = np.zeros(legs)

    def update(self, state: RobotState, idle: BoolArray | None, joints: JointFollowing | None) -> None:
        """Update with a state, the joints without torque, if measured, and how joints follow, if known."""
        self._walked_s += self._period_s
        if idle is not None and (self._counts or np.count_nonzero(idle) >= JOINTS_PER_LEG):
            self._count_idle(idle)
        if not self._starts:
            return
        self.start = np.zeros_like(self.start)
        self._starts = self._walked_s <= self._lasts_s
        if self._starts:
            now = self._walked_s <= self._first_s
            if state.measured and joints is not None:
                self._follow(state.joint_positions_rad, joints.expected_rad, now)
            if state.joint_torques_nm is None and state.foot_contacts is not None:
                self._touch(state.foot_contacts, now)

    def _count_idle(self, idle: BoolArray) -> None:
        coxae, femora, tibiae = (idle[..., kind::JOINTS_PER_LEG] for kind in range(JOINTS_PER_LEG))
        dead = coxae & femora & tibiae
        if not (self._counts or np.count_nonzero(dead)):
            return
        many = np.count_nonzero(~dead, axis=-1, keepdims=True) > N_LEGS // 2
        self._idle_s = (self._idle_s + self._period_s * many) * dead
        self.idle = self._idle_s / self._most_idle_s
        self._counts = bool(np.count_nonzero(self._idle_s))

    def forget(self, leg: int, row: tuple[int, ...] = ()) -> None:
        """Give a leg, 1..6, time to show torque after it is put down again."""
        place = (*row, leg - 1)
        self._idle_s[place], self.idle[place], self.follows[place] = 0.0, 0.0, True

    def kind(self, leg: int, row: tuple[int, ...] = ()) -> Failure:
        """How leg 1..6 has failed by the evidence of the start."""
        place = (*row, leg - 1)
        if self.follows[place]:
            return Failure(leg=leg, kind="missing")
        return Failure(leg=leg, kind="limp" if self._idle_s[place] > LIMP_S else "locked")

    def _follow(self, measured_rad: FloatArray, expected_rad: FloatArray, now: BoolArray) -> None:
        """Compare the gains of the legs since the start."""
        if self._origin is None:
            self._origin = measured_rad.copy(), expected_rad.copy()
        measured, expected = measured_rad - self._origin[0], expected_rad - self._origin[1]
        self._sums += np.stack([measured, expected, measured * expected, expected * expected])
        self._count += 1
        mean, wanted, both, square = self._sums / self._count
        covariance, variance = by_leg(np.stack([both - mean * wanted, square - wanted * wanted])).sum(-1)
        gain = covariance / np.maximum(variance, LEAST_SPREAD_RAD**2)
        usual = np.sort(gain, axis=-1)[..., 2:4].mean(axis=-1, keepdims=True)
        share = gain / np.maximum(usual, LEAST_USUAL)
        tells = (variance > LEAST_SPREAD_RAD**2) & (usual > LEAST_USUAL) & now
        self.follows = np.where(now, covariance > FOLLOWS_GAIN * variance, self.follows)
        self.start = tells * (1 - share) / (1 - LEAST_GAIN)

    def _touch(self, contacts: BoolArray, now: BoolArray) -> None:
        """Accuse feet without contact if most feet had contact."""
        self._touched = self._touched | contacts
        if self._walked_s > TOUCHED_S and not self._touched.all():
            many = np.count_nonzero(self._touched, axis=-1, keepdims=True) > N_LEGS // 2
            self.start = np.maximum(self.start, 2.0 * (many & now & ~self._touched))
