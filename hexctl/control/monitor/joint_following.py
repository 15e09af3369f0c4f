"""Joint following: how much worse than usual each joint follows its targets.

The residual r is the measured angle's distance from the range of the lagged targets of the last ticks, less
the usual distance of that joint in that part of its cycle:

    rho = mean(r^2) / (var(target) + (4 deg)^2)     mean over 0.4, variance over one cycle

It is near 0 for a joint that follows as usual, near 1 for one that does not move. An intact joint at its
torque limit does not follow either: then only its swing counts, unless it always needs all its torque to
swing.
"""

import math

import numpy as np
from numpy.typing import NDArray

from hexctl.control.monitor.phase_habit import PARTS, RATE_PER_CYCLE, PhaseHabit
from hexctl.gait.foot_trajectory import in_stance
from hexctl.types import JOINTS_PER_LEG, N_JOINTS, N_LEGS, BoolArray, FloatArray, RobotState

LAG_S = 0.03

#: Beyond that a servo may be late by this time: damping and dead time. Its estimate has a time constant in
#: cycles and an interval in ticks, and minimum joint speed for learning it.
MOST_LATE_S, LATE_CYCLES, LATE_TICKS, LEAST_SPEED_RAD_S = 0.15, 3.0, 4, math.radians(10.0)

#: Ticks of lagged targets that a joint may be at, because servos and states are late.
RANGE_TICKS = 4

#: Variance of a joint that hardly moves.
LEAST_VARIANCE_RAD2 = math.radians(4.0) ** 2

#: Time constant of the mean square residual, in cycles.
MEAN_CYCLES = 0.4

#: A servo is at its limit between these shares of the maximum torque observed in the other legs.
ALL_IT_HAS, MORE_THAN_ALL = 0.85, 1.05

#: Cycles until it is known, and share of the rated torque that counts as the limit until then.
KNOWN_AFTER_CYCLES, MUCH = 2.0, 0.4

#: Decay of that maximum torque per cycle.
FORGOTTEN_PER_CYCLE = 0.02

#: Ticks between comparisons with the other legs. Cycles are rarely a multiple of it.
COMPARED_TICKS = 7

#: A joint needs all its torque to swing if it gives that in this share of its recent swings.
NEEDS_ALL, NEEDS_ALL_CYCLES = 0.4, 6.0

#: A leg with a higher rho does not teach the habit.
SUSPICIOUS = 0.15

#: Whether a foot is in the air in each part of the cycle, (12,).
SWINGS = ~in_stance((np.arange(PARTS) + 0.5) / PARTS)


class JointFollowing:
    """Rho of each joint, leading shape + (18,), and its maximum in each leg, tick by tick."""

    def __init__(
        self, shape: tuple[int, ...], period_s: float, cycles: FloatArray, limits_nm: FloatArray
    ) -> None:
        joints, legs = (*shape, N_JOINTS), (*shape, N_LEGS)
        # Arrays of equal shape are the fastest to compute with, so the constants have it too.
        per_tick = np.repeat(np.asarray(cycles)[..., np.newaxis], N_JOINTS, axis=-1)
        self._period_s = period_s
        self._at_rest_rad: FloatArray | None = None
        self._overload = Overload(per_tick, limits_nm)
        self._legs = np.repeat(np.arange(int(np.prod(legs))).reshape(legs), JOINTS_PER_LEG, axis=-1)
        self._twice = np.stack([self._legs, self._legs])
        self._habit = PhaseHabit((2, *joints), self._twice)  # distance from the targets, and its spread
        self._parts: NDArray[np.int64] = self._legs
        self._swings: BoolArray = np.zeros(joints, dtype=bool)
        self._unusual: FloatArray = np.zeros((2, *joints))  # deviation of both from the habit
        self._unusual_rad, self._wider_rad = self._unusual
        self._learns = np.stack([RATE_PER_CYCLE * per_tick] * 2)
        self._suspicious = np.full(legs, SUSPICIOUS)
        # Running means of the lagged targets, their squared deviations, and the squared residuals.
        self._now: FloatArray = np.zeros((3, *joints))
        self._mean: FloatArray = np.zeros((3, *joints))
        self._shares = np.stack([per_tick, per_tick, np.minimum(1.0, per_tick / MEAN_CYCLES)])
        self._lagged, self._squares = self._now[0], self._now[1:]
        self._target_mean, self._target_variance, self._square = self._mean
        self._deviations: FloatArray = np.zeros((2, *joints))
        self._away_rad, self._residual_rad = self._deviations
        self._none, self._least_variance = np.zeros(joints), np.full(joints, LEAST_VARIANCE_RAD2)
        self._lag_share = np.full(joints, 1 - math.exp(-period_s / LAG_S))
        # The change of the lagged targets in a tick, and its products: their ratio is by how many it is late.
        self._change_rad: FloatArray = np.zeros(joints)
        self._late_now: FloatArray = np.zeros((2, *joints))
        self._late_means: FloatArray = np.zeros((2, *joints))
        self._late_share = np.stack([np.minimum(1.0, LATE_TICKS * per_tick / LATE_CYCLES)] * 2)
        self._least_change_rad2 = np.full(joints, (LEAST_SPEED_RAD_S * period_s) ** 2)
        self._most_late_ticks = np.full(joints, MOST_LATE_S / period_s)
        self._late_ticks: FloatArray = np.zeros(joints)
        self._ticks = 0
        self._ring: FloatArray | None = None
        self._row = 0
        self.rho: FloatArray = np.zeros(joints)
        # Views of rho, for its maximum in each leg.
        self._rho_of_kinds = tuple(self.rho[..., kind::JOINTS_PER_LEG] for kind in range(JOINTS_PER_LEG))
        self.rho_of_legs: FloatArray = np.zeros(legs)

    def update(self, state: RobotState, parts: NDArray[np.int64], size_nm: FloatArray | None = None) -> None:
        """Take a state, parts of the cycle, (6,) for the legs, and torques without signs, (18,), if known."""
        if self._ring is None:
            return
        if parts is not self._parts:
            self._parts, self._swings = parts, SWINGS[parts].take(self._legs)
        if self._at_rest_rad is None:
            # Sag of the joints in the stance, and sensor offsets.
            self._at_rest_rad = state.joint_positions_rad - self._lagged
        measured = state.joint_positions_rad - self._at_rest_rad
        low, high = np.minimum.reduce(self._ring), np.maximum.reduce(self._ring)
        off_rad = measured - np.minimum(np.maximum(measured, low), high)
        usual = self._habit.at(parts)
        np.subtract(off_rad, usual[0], out=self._unusual_rad)
        np.subtract(np.abs(self._unusual_rad), usual[1], out=self._wider_rad)
        np.maximum(self._wider_rad, self._none, out=self._residual_rad)
        if size_nm is not None:
            tells = self._overload.tells(size_nm, self._swings)
            if tells is not None:
                self._residual_rad *= tells
        np.subtract(self._lagged, self._target_mean, out=self._away_rad)
        np.square(self._deviations, out=self._squares)
        self._mean += self._shares * (self._now - self._mean)
        np.divide(self._square, self._target_variance + self._least_variance, out=self.rho)
        coxae, femora, tibiae = self._rho_of_kinds
        self.rho_of_legs = np.maximum(np.maximum(coxae, femora), tibiae)
        suspicious = self._learn()
        self._ticks += 1
        if self._ticks % LATE_TICKS == 0:
            self._learn_late(measured, suspicious)

    def sent(self, targets_rad: FloatArray, age_s: float) -> None:
        """Take the targets of a tick, leading shape + (18,), sent after a state of an age."""
        if self._ring is None:
            late = RANGE_TICKS + round(age_s / self._period_s)
            self._ring = np.repeat(targets_rad[np.newaxis], late, axis=0)
            self._lagged[...] = self._target_mean[...] = targets_rad
        self._change_rad = self._lag_share * (targets_rad - self._lagged)
        self._lagged += self._change_rad
        self._ring[self._row] = self._lagged
        self._row = (self._row + 1) % len(self._ring)

    @property
    def expected_rad(self) -> FloatArray:
        """Expected measurements of joints that follow as at rest, leading shape + (18,)."""
        expected_rad: FloatArray = self._lagged
        return expected_rad if self._at_rest_rad is None else expected_rad + self._at_rest_rad

    def off_rad(self, measured_rad: FloatArray) -> FloatArray:
        """Distance of joints from lagged targets, as late as usual, with or without the offset at rest.

        A servo that moves as fast as its target may give no torque, however late it is.
        """
        if self._at_rest_rad is None:
            return self._none
        off_rad = measured_rad - self._lagged
        off_rad += self._late_ticks * self._change_rad
        least_rad: FloatArray = np.minimum(np.abs(off_rad), np.abs(off_rad - self._at_rest_rad))
        return least_rad

    def forget(self, which: BoolArray) -> None:
        """Forget the residuals of some robots, leading shape + (1,)."""
        self._square *= ~which

    def _learn(self) -> BoolArray:
        """Learn the habit of legs that follow; which legs do not, leading shape + (6,)."""
        suspicious: BoolArray = self.rho_of_legs > self._suspicious
        learns = self._learns
        if np.count_nonzero(suspicious):
            learns = learns * ~suspicious.take(self._twice)
        self._habit.learn(learns * self._unusual)
        return suspicious

    def _learn_late(self, measured_rad: FloatArray, suspicious: BoolArray) -> None:
        """Update the means of least squares: the distance behind the targets over their change."""
        behind, squares = self._late_now
        np.multiply(self._lagged - measured_rad, self._change_rad, out=behind)
        np.square(self._change_rad, out=squares)
        change = self._late_share * (self._late_now - self._late_means)
        if np.count_nonzero(suspicious):
            change *= ~suspicious.take(self._twice)
        self._late_means += change
        behind, squares = self._late_means
        late_ticks = np.maximum(behind / (squares + self._least_change_rad2), self._none)
        self._late_ticks = np.minimum(late_ticks, self._most_late_ticks)


class Overload:
    """Servos at the maximum torque of other legs, (18,), tick by tick, whose joints need not follow."""

    def __init__(self, cycles: FloatArray, limits_nm: FloatArray) -> None:
        self._cycles, self._much_nm = cycles, MUCH * limits_nm
        self._walked_cycles = np.zeros_like(cycles)
        self._known, self._ticks = False, 0
        self._greatest_nm = np.zeros_like(cycles)
        self._kept = 1 - FORGOTTEN_PER_CYCLE * COMPARED_TICKS * cycles
        self._all_it_has_nm, self._more_nm = np.zeros_like(cycles), np.zeros_like(cycles)
        joints = np.arange(cycles.size).reshape(*cycles.shape[:-1], N_LEGS, JOINTS_PER_LEG)
        others = [np.roll(joints, legs, axis=-2).reshape(cycles.shape) for legs in range(1, N_LEGS)]
        self._others = np.stack(others)  # the same joint of the other legs
        swings = COMPARED_TICKS * cycles * SWINGS.size / np.count_nonzero(SWINGS)
        self._swing_rate = np.minimum(1.0, swings / NEEDS_ALL_CYCLES)
        self._all_in_swings: FloatArray = np.zeros_like(cycles)  # share of the swings
        self._can_swing: BoolArray = np.ones(cycles.shape, dtype=bool)

    def tells(self, size_nm: FloatArray, swings: BoolArray) -> BoolArray | None:
        """Take torques without signs, (18,): joints that are evidence if they do not follow; None for all."""
        np.maximum(self._greatest_nm, size_nm, out=self._greatest_nm)
        compares = self._ticks % COMPARED_TICKS == 0
        self._ticks += 1
        if compares:
            self._greatest_nm *= self._kept
            others_nm = np.maximum.reduce(self._greatest_nm.take(self._others))
            self._all_it_has_nm, self._more_nm = ALL_IT_HAS * others_nm, MORE_THAN_ALL * others_nm
        strained = size_nm > self._all_it_has_nm
        if self._known and not (compares or np.count_nonzero(strained)):
            return None
        spares = ~strained | (size_nm >= self._more_nm)
        if compares:
            self._all_in_swings += self._swing_rate * swings * (~spares - self._all_in_swings)
            self._can_swing = self._all_in_swings < NEEDS_ALL
        if not self._known:
            spares &= (size_nm <= self._much_nm) | (self._walked_cycles >= KNOWN_AFTER_CYCLES)
            self._walked_cycles += self._cycles
            self._known = bool((self._walked_cycles >= KNOWN_AFTER_CYCLES).all())
        return (swings & self._can_swing) | spares
