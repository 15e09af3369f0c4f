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

#: Ticks between updates, and earlier ticks that an update needs, besides the age of a state.
BLOCK_TICKS, EARLIER_TICKS = 20, 3

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

#: The present compliance counts if the torque varies by at least this share of its usual variance.
LEAST_VARIATION = 0.3

#: Mean weight of the samples of a joint whose motion the equation explains, whatever its compliance.
LEAST_FIT = 0.4

#: Cycles for which a joint must be weak.
HELD_CYCLES = 0.6

#: A joint below this share of its stiffness teaches nothing, for so many cycles.
DOUBTFUL_SHARE, DOUBTED_CYCLES = 0.85, 3.0


class JointStiffness:
    """Weak joints, block by block of ticks; joints have the leading shape + (18,).

    Args:
        cycles: of one tick, leading shape.
        limits_nm: maximum torques of the servos, (18,).

    Attributes:
        new: joints found weak in the last update.
        share: present stiffness of each joint as a share of its usual one, or of the other legs' if it was
            weak from the start.
        error: standard deviation of the share.
    """

    def __init__(self, shape: tuple[int, ...], cycles: FloatArray, limits_nm: FloatArray) -> None:
        joints = (*shape, N_JOINTS)
        self._cycles = np.broadcast_to(BLOCK_TICKS * np.asarray(cycles)[..., np.newaxis], joints)
        self._limits_nm = limits_nm
        self._walked: FloatArray = np.zeros(joints)
        self._shaft_rad: FloatArray | None = None
        self._moments: FloatArray = np.zeros((*joints, _ROWS, _ROWS))
        self._coefficients: FloatArray = np.zeros((*joints, _ROWS - 1))
        self._variance: FloatArray = np.ones(joints)
        # Means over the last half cycle: weight, torque and rest, their products, and unweighted torques.
        self._present: FloatArray = np.zeros((7, *joints))
        self._present_share = np.minimum(1.0, self._cycles / PRESENT_CYCLES)
        self._compliance: FloatArray = np.zeros(joints)
        # Slow means: share of samples at the limit, variance of the torque, squared change of compliance.
        self._slow: FloatArray = np.zeros((3, *joints))
        self._most: FloatArray = np.zeros(joints)
        self._doubted: FloatArray = np.zeros(joints)
        self._teaches: BoolArray = np.ones(joints, dtype=bool)
        places = np.arange(self._most.size).reshape(*shape, N_LEGS, JOINTS_PER_LEG)
        others = [np.roll(places, legs, axis=-2).reshape(joints) for legs in range(1, N_LEGS)]
        self._others = np.stack(others)  # the same joint of the other legs
        self._held: FloatArray = np.zeros(joints)
        self.weak: BoolArray = np.zeros(joints, dtype=bool)
        self.new: BoolArray = np.zeros(joints, dtype=bool)
        self.share: FloatArray = np.ones(joints)
        self.error: FloatArray = np.zeros(joints)

    def update(self, motion: RecentMotion, age_ticks: int, watched: BoolArray) -> None:
        """Take the last ticks of the motion, with states of an age; watched legs have the shape + (6,)."""
        rows = motion.last(BLOCK_TICKS + EARLIER_TICKS + age_ticks)
        self.new = np.zeros_like(self.weak)
        # A sum is finite only if every term is.
        if rows is None or not math.isfinite(np.add.reduce(rows, axis=None)):
            return
        samples = self._samples(rows, age_ticks)
        self._walked = self._walked + self._cycles
        known = bool(self._variance.max() < 1)
        rest = self._rest(samples)
        torque = samples[..., _TORQUE, :]
        size = np.abs(torque)
        below = size < AT_LIMIT * self._most_of_kind(size.max(axis=-1))[..., np.newaxis]
        weights = below.astype(float)
        if known:
            off = np.abs(rest - self._compliance[..., np.newaxis] * torque)
            weights *= np.minimum(
                1.0, HUBER * np.sqrt(self._variance)[..., np.newaxis] / np.maximum(off, 1e-12)
            )
        slow = np.maximum(self._cycles / USUAL_CYCLES, self._cycles / self._walked)
        self._learn(samples, weights, slow)
        if self._walked.min() < FIRST_CYCLES:
            return
        error2 = self._solve()
        if not known:
            self._compliance = self._coefficients[..., _TORQUE].copy()
            return
        now = np.stack(
            [weights, torque, torque * torque, *(weights * one for one in _products(torque, rest))]
        )
        joints = np.repeat(watched, JOINTS_PER_LEG, axis=-1)
        self._judge(now.mean(axis=-1), 1 - below.mean(axis=-1), slow, error2, joints)

    def _samples(self, rows: FloatArray, age: int) -> FloatArray:
        """Samples of a block, leading shape + (18, 7, ticks), of measured angles, targets and torques."""
        measured, targets, torques = rows
        samples: FloatArray = np.empty((_ROWS, BLOCK_TICKS, *measured.shape[1:]))
        now, before = measured[-BLOCK_TICKS:], measured[-BLOCK_TICKS - 1 : -1]
        early, middle, late = (targets[-BLOCK_TICKS - lag - age : -lag - age] for lag in (1, 2, 3))
        samples[0] = 1.0
        np.divide(torques[-BLOCK_TICKS:], self._limits_nm, out=samples[_TORQUE])
        np.subtract(early, middle, out=samples[2])
        np.subtract(middle, late, out=samples[3])
        np.subtract(now, before, out=samples[4])
        np.subtract(middle, self._behind_play(middle), out=samples[5])
        np.subtract(middle, (now + before) / 2, out=samples[6])
        return np.ascontiguousarray(np.moveaxis(samples, (0, 1), (-2, -1)))

    def _behind_play(self, targets_rad: FloatArray) -> FloatArray:
        """Shafts that follow targets, (ticks,) + leading shape + (18,), with play."""
        low, high = targets_rad - HALF_PLAY_RAD, targets_rad + HALF_PLAY_RAD
        shaft_rad = targets_rad[0] if self._shaft_rad is None else self._shaft_rad
        shafts_rad: FloatArray = np.empty(targets_rad.shape)
        for row in range(BLOCK_TICKS):
            shaft_rad = np.minimum(np.maximum(shaft_rad, low[row]), high[row], out=shafts_rad[row])
        self._shaft_rad = shaft_rad
        return shafts_rad

    def _rest(self, samples: FloatArray) -> FloatArray:
        """Distance from the target that is not explained by anything but the torque."""
        others = self._coefficients.copy()
        others[..., _TORQUE] = 0.0
        explained = np.matmul(others[..., np.newaxis, :], samples[..., :-1, :])[..., 0, :]
        rest: FloatArray = samples[..., -1, :] - explained
        return rest

    def _most_of_kind(self, size: FloatArray) -> FloatArray:
        """Maximum torque of the joints of a kind."""
        kinds = _of_legs(size).max(axis=-2, keepdims=True)
        most = np.broadcast_to(kinds, (*kinds.shape[:-2], N_LEGS, JOINTS_PER_LEG)).reshape(size.shape)
        self._most = np.maximum((1 - FADES_PER_CYCLE * self._cycles) * self._most, most)
        return self._most

    def _learn(self, samples: FloatArray, weights: FloatArray, slow: FloatArray) -> None:
        weighted = samples * weights[..., np.newaxis, :]
        moments = np.matmul(weighted, samples.swapaxes(-1, -2)) / samples.shape[-1]
        rate = (slow * self._teaches)[..., np.newaxis, np.newaxis]
        self._moments = self._moments + rate * (moments - self._moments)

    def _solve(self) -> FloatArray:
        """Solve for all coefficients; the variance of the usual compliance."""
        left, right = self._moments[..., :-1, :-1], self._moments[..., :-1, -1]
        left = left + _RIDGE
        scale = np.sqrt(np.diagonal(left, axis1=-2, axis2=-1)) + LEAST_RAD2
        left = left / (scale[..., np.newaxis] * scale[..., np.newaxis, :]) + _LITTLE
        both: FloatArray = np.zeros((*right.shape, 2))
        both[..., 0], both[..., _TORQUE, 1] = right / scale, 1.0
        solved = np.linalg.solve(left, both)
        self._coefficients = solved[..., 0] / scale
        weight = np.maximum(self._moments[..., 0, 0], LEAST_RAD2)
        left_over = self._moments[..., -1, -1] - np.add.reduce(solved[..., 0] * both[..., 0], axis=-1)
        self._variance = np.maximum(left_over, LEAST_RAD2) / weight
        count = SAMPLES_PER_CYCLE * np.minimum(self._walked, 2 * USUAL_CYCLES)
        error2: FloatArray = self._variance * solved[..., _TORQUE, 1] / (scale[..., _TORQUE] ** 2 * count)
        return error2

    def _judge(
        self, now: FloatArray, at_limit: FloatArray, slow: FloatArray, error2: FloatArray, watched: BoolArray
    ) -> None:
        """Compare the present compliance, from the means of a block, (7,) + joints, with the usual one."""
        usual = self._coefficients[..., _TORQUE]
        self._present = self._present + self._present_share * (now - self._present)
        weight, mean, square, torque, rest, squares, product = self._present
        weight = np.maximum(weight, LEAST_WEIGHT)
        spread = np.maximum(squares - torque * torque / weight, LEAST_TORQUE2)
        self._compliance = (product - torque * rest / weight) / spread
        variation, change = square - mean * mean, self._compliance - usual
        varies = variation >= LEAST_VARIATION * self._slow[1]
        self._slow[:2] += slow * (np.stack([at_limit, variation]) - self._slow[:2])
        self._slow[2] += slow * (self._teaches & varies) * (change * change - self._slow[2])
        known = (self._walked > KNOWN_CYCLES) & (error2 < (KNOWN_TO * usual) ** 2) & watched & ~self.weak
        error2 = error2 + OF_USUAL_CHANGE * self._slow[2]
        error2 += self._variance / (spread * 2 * PRESENT_CYCLES * SAMPLES_PER_CYCLE)
        known &= usual > 0
        some = np.maximum(usual, LEAST_COMPLIANCE)
        self.share = some / np.maximum(self._compliance, 0.01 * some)
        self._doubt(known)
        others = np.minimum.reduce(np.where(known, np.minimum(self.share, 1.0), 1.0).take(self._others))
        weak = (
            known & varies & (weight > LEAST_FIT) & (self.share < np.minimum(WEAK_SHARE, STANDS_OUT * others))
        )
        weak &= change > SIGMAS * np.sqrt(error2)
        weak |= known & self._weak_from_start(usual, error2, known)
        self._held = (self._held + self._cycles) * weak
        self.new = self._held >= HELD_CYCLES
        self.weak = self.weak | self.new
        self.error = self.share * np.sqrt(error2) / np.maximum(self._compliance, some)

    def _doubt(self, known: BoolArray) -> None:
        """Let joints that may be weak teach nothing, for a while."""
        self._doubted = (self._doubted + self._cycles) * (known & (self.share < DOUBTFUL_SHARE))
        self._teaches = (self._doubted == 0) | (self._doubted >= DOUBTED_CYCLES)

    def _weak_from_start(self, usual: FloatArray, error2: FloatArray, known: BoolArray) -> BoolArray:
        """Which joints are weaker than those of any other leg, leading shape + (18,)."""
        others = np.maximum.reduce(np.where(known, usual, 0.0).take(self._others))
        weak: BoolArray = (others > 0) & (others < WEAK_FROM_START * usual) & (self._slow[0] < MOST_AT_LIMIT)
        weak &= (usual - others > SIGMAS_FROM_START * np.sqrt(error2)) & (self._walked > COMPARED_CYCLES)
        self.share = np.where(weak, others / np.maximum(usual, LEAST_COMPLIANCE), self.share)
        return weak


def _products(torque: FloatArray, rest: FloatArray) -> tuple[FloatArray, ...]:
    return torque, rest, torque * torque, torque * rest


def _of_legs(joints: FloatArray) -> FloatArray:
    return joints.reshape(*joints.shape[:-1], N_LEGS, JOINTS_PER_LEG)
