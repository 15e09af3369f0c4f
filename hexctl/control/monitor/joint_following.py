"""Joint following: how much worse than usual each joint follows its targets.

A servo follows its target with a lag. What is left between the measured angle and the range of the lagged
targets of the last ticks, less what is usual for that joint at that part of its cycle, is the residual r:

    rho = mean(r^2) / (var(target) + (4 deg)^2)     mean over 0.4, variance over one cycle

It is near 0 for a joint that follows as always, and near 1 for one that does not move. Under a load at
which its servo gives all it has a whole joint does not follow either: what it does then, in the stance, says
nothing, and its swing has to show.
"""

import math

import numpy as np

from hexctl.control.monitor.phase_habit import PARTS, RATE_PER_CYCLE, PhaseHabit
from hexctl.gait.foot_trajectory import in_stance
from hexctl.types import JOINTS_PER_LEG, N_JOINTS, N_LEGS, BoolArray, FloatArray, RobotState

#: Lag of a servo behind its target.
LAG_S = 0.03

#: Ticks whose lagged targets a joint may be at: servos and states come late.
RANGE_TICKS = 4

#: Variance of a joint that is hardly moved.
LEAST_VARIANCE_RAD2 = math.radians(4.0) ** 2

#: Time constant of the mean square residual, in cycles.
MEAN_CYCLES = 0.4

#: A servo gives all it has between these shares of the greatest torque that servos like it were seen to give.
ALL_IT_HAS, MORE_THAN_ALL = 0.85, 1.05

#: Until that is known, for so many cycles, a servo may give all it has from this share of what it should.
KNOWN_AFTER_CYCLES, MUCH = 2.0, 0.4

#: Share of that greatest torque that is forgotten in a cycle.
FORGOTTEN_PER_CYCLE = 0.02

#: A leg whose rho is above this no longer teaches what is usual.
SUSPICIOUS = 0.15


class JointFollowing:
    """Rho of each joint, tick by tick.

    Args:
        shape: leading shape.
        period_s: control period.
        limits_nm: greatest torques of the servos, (18,), by what the robot file says.
    """

    def __init__(self, shape: tuple[int, ...], period_s: float, limits_nm: FloatArray) -> None:
        self._shape, self._period_s = shape, period_s
        joints = (*shape, N_JOINTS)
        self._habit = PhaseHabit(joints)
        self._square: FloatArray = np.zeros(joints)
        self._target_variance: FloatArray = np.zeros(joints)
        self._target_mean: FloatArray = np.zeros(joints)
        self._ring: FloatArray = np.zeros((0, *joints))
        self._lagged: FloatArray | None = None
        self._row, self._begun = 0, False
        self._limits_nm = limits_nm.reshape(N_LEGS, JOINTS_PER_LEG)
        self._walked_cycles = 0.0
        self._greatest_nm: FloatArray = np.zeros((*shape, N_LEGS, JOINTS_PER_LEG))
        self._lag_share = 1 - math.exp(-period_s / LAG_S)
        self.rho: FloatArray = np.zeros(joints)

    def update(self, state: RobotState, phases: FloatArray, cycles: FloatArray) -> None:
        """Take the state of a tick.

        Args:
            state: as measured.
            phases: normalised times of the legs, leading shape + (6,).
            cycles: that one tick takes, leading shape.
        """
        if self._lagged is None:
            return
        low, high = self._ring.min(axis=0), self._ring.max(axis=0)
        measured = state.joint_positions_rad
        off_rad = measured - np.minimum(np.maximum(measured, low), high)
        if not self._begun:
            self._habit.begin(off_rad)  # how joints hang in the stance, and where their sensors are off
            self._begun = True
        parts = np.minimum((phases * PARTS).astype(int), PARTS - 1)
        usual_rad, spread_rad = self._habit.at(np.repeat(parts, JOINTS_PER_LEG, axis=-1))
        unusual_rad = off_rad - usual_rad
        size_rad = np.abs(unusual_rad)
        per_cycle = np.asarray(cycles)[..., np.newaxis]
        residual_rad = np.maximum(size_rad - spread_rad, 0.0)
        if state.joint_torques_nm is not None:
            residual_rad *= ~self._overloaded(state.joint_torques_nm, phases, per_cycle)
        self._square += np.minimum(1.0, per_cycle / MEAN_CYCLES) * (
            residual_rad * residual_rad - self._square
        )
        away_rad = self._lagged - self._target_mean
        self._target_mean += per_cycle * away_rad
        self._target_variance += per_cycle * (away_rad * away_rad - self._target_variance)
        self.rho = self._square / (self._target_variance + LEAST_VARIANCE_RAD2)
        learn = RATE_PER_CYCLE * per_cycle * self._calm()
        self._habit.learn(learn * unusual_rad, learn * (size_rad - spread_rad))

    def sent(self, targets_rad: FloatArray, age_s: float) -> None:
        """Take the targets of a tick, leading shape + (18,), sent after a state of an age."""
        if self._lagged is None:
            late = RANGE_TICKS + round(age_s / self._period_s)
            self._ring = np.repeat(targets_rad[np.newaxis], late, axis=0)
            self._lagged, self._target_mean = targets_rad.copy(), targets_rad.copy()
        self._lagged += self._lag_share * (targets_rad - self._lagged)
        self._ring[self._row] = self._lagged
        self._row = (self._row + 1) % len(self._ring)

    def forget(self, which: BoolArray) -> None:
        """Forget the residuals of some robots, leading shape + (1,)."""
        self._square *= ~which

    def _overloaded(self, torques_nm: FloatArray, phases: FloatArray, per_cycle: FloatArray) -> BoolArray:
        """Whether joints of legs in the stance give all the torque they have, leading shape + (18,).

        That is about as much as the same joint of another leg gave at most: a jammed joint soon takes more.
        """
        legs_nm = np.abs(torques_nm).reshape(*self._shape, N_LEGS, JOINTS_PER_LEG)
        kept = 1 - FORGOTTEN_PER_CYCLE * per_cycle[..., np.newaxis]
        self._greatest_nm = np.maximum(self._greatest_nm * kept, legs_nm)
        second_nm, first_nm = np.moveaxis(np.sort(self._greatest_nm, axis=-2)[..., -2:, :], -2, 0)
        others_nm = np.where(
            self._greatest_nm < first_nm[..., np.newaxis, :],
            first_nm[..., np.newaxis, :],
            second_nm[..., np.newaxis, :],
        )
        all_it_has = (legs_nm > ALL_IT_HAS * others_nm) & (legs_nm < MORE_THAN_ALL * others_nm)
        if self._walked_cycles < KNOWN_AFTER_CYCLES:
            all_it_has |= legs_nm > MUCH * self._limits_nm
            self._walked_cycles += float(per_cycle.min())
        stance = in_stance(phases)[..., np.newaxis]
        return np.asarray((all_it_has & stance).reshape(torques_nm.shape))

    def _calm(self) -> FloatArray:
        """1 for the joints of legs that follow as usual, leading shape + (18,)."""
        legs = self.rho.reshape(*self._shape, N_LEGS, JOINTS_PER_LEG).max(axis=-1) < SUSPICIOUS
        return np.repeat(legs, JOINTS_PER_LEG, axis=-1)
