"""Joint stiffness: which joints have become weaker, and how much of their torque they have left.

A position servo is a spring between its target u and its angle q: with a share s of its torque it has a share
s of its stiffness. Over tick t, with mean angle q, mean torque tau and motion dq,

    u(t - 2) - q = a + c tau + d1 (u(t - 1) - u(t - 2)) + d2 (u(t - 2) - u(t - 3)) + e dq + p v

c is the compliance, the inverse of the stiffness. d1 and d2 place the delay, and e is the damping. v is how
far the target is from a shaft that follows it with play (the play operator of Prandtl and Ishlinskii). The
coefficients come from weighted least squares over the last cycles, with Huber's weights, and without ticks
in which a servo gives the maximum torque of its kind. Compliance c' of the last half cycle comes from the
same equation with all other coefficients kept. The share is

    s = c / c'
"""

import math

import numpy as np

from hexctl.control.monitor.recent_motion import RecentMotion
from hexctl.types import JOINTS_PER_LEG, N_JOINTS, N_LEGS, BoolArray, FloatArray

#: Ticks between updates, earlier ticks that an update needs, besides the age of a state, and updates between
#: solutions for all coefficients.
BLOCK_TICKS, EARLIER_TICKS, SOLVE_BLOCKS = 20, 3, 2

#: Half the play between a servo and its joint, by which v is computed: p adapts it to the real one.
HALF_PLAY_RAD = math.radians(0.3)

#: Rows of the samples: constant, torque, two of the delay, motion, play, distance from the target.
_TORQUE, _ROWS = 1, 7

#: Time constants in cycles of the usual compliance and the present one.
USUAL_CYCLES, PRESENT_CYCLES = 4.0, 0.5

#: Independent samples in a cycle: play and floor disturb many ticks alike.
SAMPLES_PER_CYCLE = 8.0

#: Residuals beyond this multiple of their standard deviation lose weight.
HUBER = 2.0

#: A servo is at its limit beyond this share of its kind's maximum torque, which fades per cycle.
AT_LIMIT, FADES_PER_CYCLE = 0.85, 0.02

#: Ridge in rad^2, against coefficients that hardly any motion determines, and least divisors.
RIDGE_RAD2, LEAST_RAD2, LEAST_TORQUE2, LEAST_COMPLIANCE, LEAST_WEIGHT = 2e-7, 1e-9, 1e-9, 1e-6, 1e-3

_RIDGE: FloatArray = np.diag([0.0, 0.0, *([RIDGE_RAD2] * (_ROWS - 3))])
_LITTLE: FloatArray = 1e-6 * np.eye(_ROWS - 1)

#: Cycles until the usual compliance is estimated, known, and compared with that of other legs.
FIRST_CYCLES, KNOWN_CYCLES, COMPARED_CYCLES = 1.25, 2.5, 3.5

#: A weak joint has less than this share of its usual stiffness, and of the share of any other leg's joint.
WEAK_SHARE, STANDS_OUT = 0.75, 0.8

#: A joint weak from the start has less than this share of any other leg's stiffness: intact servos of one
#: robot differ by up to a factor of two. Its servos are at their limits for at most this share of the time.
WEAK_FROM_START, MOST_AT_LIMIT = 0.5, 0.15

#: Standard deviations by which it is weaker than usual, and than other legs. Their square includes this share
#: of the usual squared change of the compliance.
SIGMAS, SIGMAS_FROM_START, OF_USUAL_CHANGE = 2.5, 6.0, 0.5

#: The usual compliance counts if its relative standard deviation is below this.
KNOWN_TO = 0.25

#: Mean weight of the samples of a joint whose motion the equation explains, whatever its compliance.
LEAST_FIT = 0.4

#: Cycles for which a joint must be weak.
WEAK_CYCLES = 0.6

#: Least share that is measured.
LEAST_SHARE = 0.01

#: A joint below this share of its stiffness teaches nothing, for so many cycles.
DOUBTFUL_SHARE, DOUBTED_CYCLES = 0.85, 3.0


class JointStiffness:
    """Weak joints, block by block of ticks; joints have the leading shape + (18,).

    Args:
        limits_nm: maximum torques of the servos, (18,).

    Attributes:
        new: joints found weak in the last update.
        share: present stiffness of each joint as a share of its usual one, or of the other legs' if it was
            weak from the start.
        error: standard deviation of the share.
    """

    def __init__(self, shape: tuple[int, ...], limits_nm: FloatArray) -> None:
        joints = (*shape, N_JOINTS)
        self._cycles: FloatArray = np.zeros(joints)  # of the last block
        self._limits_nm = limits_nm
        self._walked: FloatArray = np.zeros(joints)
        self._shaft_rad: FloatArray = np.full(joints, np.nan)
        self._moments: FloatArray = np.zeros((*joints, _ROWS, _ROWS))
        self._coefficients: FloatArray = np.zeros((*joints, _ROWS - 1))
        self._variance, self._error2, self._no_cycles = np.ones(joints), np.ones(joints), np.zeros(joints)
        # Means over the last half cycle: weight, torque, rest, and products of the torque with both.
        self._present: FloatArray = np.zeros((5, *joints))
        self._now: FloatArray = np.zeros((5, *joints, BLOCK_TICKS))
        self._compliance, self._changes, self._spread = np.zeros(joints), np.zeros(joints), np.ones(joints)
        self._most, self._at_limit, self._doubted = np.zeros(joints), np.zeros(joints), np.zeros(joints)
        self._share_of_others: FloatArray = np.ones(joints)
        self._teaches: BoolArray = np.ones(joints, dtype=bool)
        self._none: BoolArray = np.zeros(joints, dtype=bool)
        self._known, self._fits, self._from_start = self._none, self._none, self._none
        places = np.arange(self._most.size).reshape(*shape, N_LEGS, JOINTS_PER_LEG)
        kind = [np.roll(places, legs, axis=-2).reshape(joints) for legs in range(N_LEGS)]
        self._kind = np.stack(kind)  # the same joint of all legs, of the own leg first
        self._blocks, self._rows_first = 0, (len(joints), len(joints) + 1, *range(len(joints)))
        self._weak_for: FloatArray = np.zeros(joints)
        self.weak, self.new = self._none, self._none
        self.share: FloatArray = np.ones(joints)
        self.error: FloatArray = np.zeros(joints)

    def update(self, motion: RecentMotion, age_ticks: int, watched: BoolArray) -> None:
        """Take the last ticks of the motion, with states of an age; watched legs have the shape + (6,)."""
        rows = motion.last(BLOCK_TICKS + EARLIER_TICKS + age_ticks)
        self.new = self._none
        if rows is None:
            return
        self._cycles = np.broadcast_to(
            BLOCK_TICKS * np.asarray(motion.cycles)[..., np.newaxis], self._none.shape
        )
        samples = self._samples(rows, age_ticks)
        # A sum is finite only if every term is.
        finite = np.isfinite(np.add.reduce(samples, axis=(-3, -2, -1)))[..., np.newaxis]
        if not finite.all():
            samples = np.where(finite[..., np.newaxis, np.newaxis], samples, 0.0)
            self._shaft_rad = np.where(finite, self._shaft_rad, np.nan)
        repeats = finite & motion.repeats(BLOCK_TICKS)[..., np.newaxis]
        ready = repeats & (self._walked >= FIRST_CYCLES)
        # The coefficients are those of a motion: another one is learned from its beginning.
        self._walked = np.where(repeats, self._walked, 0.0) + self._cycles
        self._teaches = self._teaches | ~repeats
        slow = np.maximum(self._cycles / USUAL_CYCLES, self._cycles / self._walked)
        torque, rest = samples[..., _TORQUE, :], self._rest(samples)
        size = np.abs(torque)
        below = size < AT_LIMIT * self._most_of_kind(np.maximum.reduce(size, axis=-1))[..., np.newaxis]
        weights = below * self._huber(torque, rest, ready)
        self._learn(samples, weights, slow)
        self._blocks += 1
        solves = self._blocks % SOLVE_BLOCKS == 0
        if solves:
            self._solve()
        self._known = self._known & repeats & np.repeat(watched, JOINTS_PER_LEG, axis=-1)
        if solves:
            self._compare_legs()
        if ready.any():
            limited = 1 - np.add.reduce(below, axis=-1) / BLOCK_TICKS
            self._at_limit = self._at_limit + slow * ready * (limited - self._at_limit)
            self._estimate(weights, torque, rest, ready)
            self._judge(slow * ready)
        else:
            self._compliance = self._coefficients[..., _TORQUE].copy()

    def _samples(self, rows: FloatArray, age: int) -> FloatArray:
        """Samples of a block, leading shape + (18, 7, ticks), of measured angles, targets and torques."""
        measured, targets, torques = rows
        by_joint: FloatArray = np.empty((*measured.shape[1:], _ROWS, BLOCK_TICKS))
        samples = by_joint.transpose(self._rows_first)
        now, before = measured[-BLOCK_TICKS:], measured[-BLOCK_TICKS - 1 : -1]
        early, middle, late = (targets[-BLOCK_TICKS - lag - age : -lag - age] for lag in (1, 2, 3))
        samples[0] = 1.0
        np.divide(torques[-BLOCK_TICKS:], self._limits_nm, out=samples[_TORQUE])
        np.subtract(early, middle, out=samples[2])
        np.subtract(middle, late, out=samples[3])
        np.subtract(now, before, out=samples[4])
        np.subtract(middle, self._behind_play(middle), out=samples[5])
        np.subtract(middle, (now + before) / 2, out=samples[6])
        return by_joint

    def _behind_play(self, targets_rad: FloatArray) -> FloatArray:
        """Shafts that follow targets, (ticks,) + leading shape + (18,), with play."""
        low, high = targets_rad - HALF_PLAY_RAD, targets_rad + HALF_PLAY_RAD
        shafts_rad: FloatArray = np.empty((BLOCK_TICKS + 1, *targets_rad.shape[1:]))
        shafts_rad[0] = shaft_rad = np.where(np.isnan(self._shaft_rad), targets_rad[0], self._shaft_rad)
        # In every other tick, and then in those between.
        for tick in range(2, BLOCK_TICKS + 1, 2):
            least_rad = np.maximum(shaft_rad, low[tick - 1])
            shaft_rad = np.minimum(least_rad, high[tick - 1], out=shafts_rad[tick])
        between = np.minimum(np.maximum(shafts_rad[:-2:2], low[::2]), high[::2])
        shafts_rad[1::2], self._shaft_rad = between, shaft_rad
        return shafts_rad[1:]

    def _rest(self, samples: FloatArray) -> FloatArray:
        """Distance from the target that is not explained by anything but the torque."""
        others = self._coefficients.copy()
        others[..., _TORQUE] = 0.0
        explained = np.matmul(others[..., np.newaxis, :], samples[..., :-1, :])[..., 0, :]
        rest: FloatArray = samples[..., -1, :] - explained
        return rest

    def _huber(self, torque: FloatArray, rest: FloatArray, ready: BoolArray) -> FloatArray:
        """Weights of samples by their distance from the equation with the present compliance."""
        off = np.abs(rest - self._compliance[..., np.newaxis] * torque)
        near = np.where(ready, HUBER * np.sqrt(self._variance), np.inf)[..., np.newaxis]
        return (
            np.asarray(near / np.maximum(off, near)) if ready.all() else np.where(off > near, near / off, 1.0)
        )

    def _most_of_kind(self, size: FloatArray) -> FloatArray:
        """Maximum torque of the joints of a kind."""
        most = np.maximum.reduce(size.take(self._kind))
        self._most = np.maximum((1 - FADES_PER_CYCLE * self._cycles) * self._most, most)
        return self._most

    def _learn(self, samples: FloatArray, weights: FloatArray, slow: FloatArray) -> None:
        weighted = samples * weights[..., np.newaxis, :]
        moments = np.matmul(weighted, samples.swapaxes(-1, -2)) / samples.shape[-1]
        rate = (slow * self._teaches)[..., np.newaxis, np.newaxis]
        self._moments = self._moments + rate * (moments - self._moments)

    def _solve(self) -> None:
        """Solve for all coefficients, and compare the usual compliances of the legs."""
        left, right = self._moments[..., :-1, :-1] + _RIDGE, self._moments[..., :-1, -1]
        scale = np.sqrt(np.diagonal(left, axis1=-2, axis2=-1)) + LEAST_RAD2
        left = left / (scale[..., np.newaxis] * scale[..., np.newaxis, :]) + _LITTLE
        both: FloatArray = np.zeros((*right.shape, 2))
        both[..., 0], both[..., _TORQUE, 1] = right / scale, 1.0
        solved = np.linalg.solve(left, both)
        self._coefficients = solved[..., 0] / scale
        weight = np.maximum(self._moments[..., 0, 0], LEAST_WEIGHT)
        left_over = self._moments[..., -1, -1] - np.add.reduce(solved[..., 0] * both[..., 0], axis=-1)
        self._variance = np.maximum(left_over, LEAST_RAD2) / weight
        count = SAMPLES_PER_CYCLE * np.minimum(self._walked, 2 * USUAL_CYCLES)
        self._error2 = self._variance * solved[..., _TORQUE, 1] / (scale[..., _TORQUE] ** 2 * count)
        usual = self._coefficients[..., _TORQUE]
        self._known = (self._walked > KNOWN_CYCLES) & (usual > 0) & ~self.weak
        self._known &= self._error2 < (KNOWN_TO * usual) ** 2

    def _compare_legs(self) -> None:
        """Look for joints that were weaker than those of any other leg from the start."""
        usual = self._coefficients[..., _TORQUE]
        others = np.maximum.reduce(np.where(self._known, usual, 0.0).take(self._kind[1:]))
        self._share_of_others = others / np.maximum(usual, LEAST_COMPLIANCE)
        sure = usual - others > SIGMAS_FROM_START * np.sqrt(self._error2 + OF_USUAL_CHANGE * self._changes)
        least = (
            self._known & (others > 0) & (self._walked > COMPARED_CYCLES) & (self._at_limit < MOST_AT_LIMIT)
        )
        self._from_start = least & sure & (self._share_of_others < WEAK_FROM_START)

    def _estimate(self, weights: FloatArray, torque: FloatArray, rest: FloatArray, ready: BoolArray) -> None:
        """Estimate the present compliance."""
        now = self._now
        now[0] = weights
        weighted = np.multiply(weights, torque, out=now[1])
        np.multiply(weights, rest, out=now[2])
        np.multiply(weighted, torque, out=now[3])
        np.multiply(weighted, rest, out=now[4])
        now = np.add.reduce(now, axis=-1) / BLOCK_TICKS
        present_share = np.minimum(1.0, self._cycles / PRESENT_CYCLES)
        self._present = self._present + present_share * ready * (now - self._present)
        weight, mean, rest_mean, square, product = self._present
        self._fits = weight > LEAST_FIT
        weight = np.maximum(weight, LEAST_WEIGHT)
        self._spread = np.maximum(square - mean * mean / weight, LEAST_TORQUE2)
        present = (product - mean * rest_mean / weight) / self._spread
        self._compliance = np.where(ready, present, self._coefficients[..., _TORQUE])

    def _judge(self, slow: FloatArray) -> None:
        """Compare the present compliance with the usual one."""
        usual, known = self._coefficients[..., _TORQUE], self._known
        change = self._compliance - usual
        self._changes = self._changes + slow * self._teaches * (change * change - self._changes)
        some = np.maximum(usual, LEAST_COMPLIANCE)
        self.share = some / np.maximum(self._compliance, LEAST_SHARE * some)
        self._from_start = self._from_start & known
        doubtful = known & (self.share < DOUBTFUL_SHARE)
        self._doubted = (self._doubted + self._cycles) * doubtful
        self._teaches = ~doubtful | (self._doubted >= DOUBTED_CYCLES)
        if not (np.count_nonzero(doubtful) or np.count_nonzero(self._from_start)):
            self._weak_for = self._no_cycles
            return
        error2 = self._error2 + OF_USUAL_CHANGE * self._changes
        error2 += self._variance / (self._spread * 2 * PRESENT_CYCLES * SAMPLES_PER_CYCLE)
        others = np.minimum.reduce(np.where(known, np.minimum(self.share, 1.0), 1.0).take(self._kind[1:]))
        weak = doubtful & self._fits & (self.share < np.minimum(WEAK_SHARE, STANDS_OUT * others))
        weak &= change > SIGMAS * np.sqrt(error2)
        self.share = np.where(self._from_start & ~weak, self._share_of_others, self.share)
        self._weak_for = (self._weak_for + self._cycles) * (weak | self._from_start)
        self.new = (self._weak_for >= WEAK_CYCLES) & ~self.weak
        self.weak = self.weak | self.new
        self._known = known & ~self.weak
        self._from_start = self._from_start & ~self.weak
        self.error = self.share * np.sqrt(error2) / np.maximum(self._compliance, some)
