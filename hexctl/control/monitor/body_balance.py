"""Body balance: which failure explains the lean of the body and the feet on the floor.

It is for servos that only echo their targets. A leg that carries nothing or is locked changes lean and
contacts in each part of the gait cycle; statics give this change tau for each leg and failure (its
signature). With D, the deviation of the last cycle from the habit, the evidence is twice the log likelihood
ratio

    2 a D'W tau - a^2 tau'W tau,   a = D'W tau / tau'W tau within 0.3 .. 1.3

W holds the inverse variances of lean and contacts, from sensors, model and floor. The variance on this floor
also sets the threshold.
"""

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from hexctl.control.monitor.phase_habit import PARTS, PhaseHabit, cycle_parts
from hexctl.gait.foot_trajectory import (
    RAMP_DURATION_S,
    StepPattern,
    feet_at_phases,
    part_of_cycle,
    stroke_vectors_m,
)
from hexctl.gait.gait import Gait, Motion
from hexctl.ik.legs import solve_legs
from hexctl.ik.statics import GRAVITY_M_S2, lean_and_forces
from hexctl.robot.model import Robot
from hexctl.types import N_LEGS, BoolArray, FloatArray, RobotState, leg_slice

#: Channels: the lean ahead and to the left, and the contact of each foot.
CHANNELS = 2 + N_LEGS
_LEAN, _FEET = slice(0, 2), slice(2, None)

#: Signatures of a leg: it carries nothing, or it locked in one of the parts of its cycle.
SIGNATURES = 1 + PARTS

#: Static solutions in each part of the cycle.
_SAMPLES = 2

#: A foot with this share of the weight certainly touches the floor.
TOUCHES_SHARE = 0.05

LAG_S = 0.03

#: After the soft start the body needs time to reach its habit.
SETTLED_S = RAMP_DURATION_S + 0.2

#: Learning rates of the last cycle and of the habit, per cycle, as in `PhaseHabit`.
LAST_CYCLE_RATE, HABIT_RATE = 24.0, 1.5

#: Standard deviations of sensors and model: of the lean in rad, and of a contact.
LEAN_RAD, CONTACT = math.radians(0.05), 0.15

#: Weight of the variance on this floor, its time constant and the start of learning in cycles.
FLOOR_TIMES, FLOOR_CYCLES, FLOOR_AFTER = 2.0, 5.0, 1.0

#: Limits of the size of a failure relative to its signature.
LEAST_SIZE, MOST_SIZE = 0.3, 1.3

#: Minimum weighted energy of a signature.
LEAST_ENERGY = 1e-9

#: Threshold on an even floor, and its increase with the variance of the lean, per rad^2.
LEAST_EVIDENCE, FOR_VARIANCE = 12.0, 800.0 / math.radians(1.0) ** 2

#: Initial variance of the lean, and the delay in cycles that keeps a failure from raising its own threshold.
FIRST_VARIANCE, FLOOR_DELAY_CYCLES = math.radians(0.25) ** 2, 1.5

#: Variance of the lean at which other evidence counts half.
BUMPY_VARIANCE = math.radians(0.3) ** 2

#: The leg with the most evidence must exceed all others by this share of it.
BEATS_BY = 0.5

#: Cycles after which the habit is known, and ticks between two evaluations.
KNOWN_AFTER_CYCLES, LOOK_TICKS = 2.0, 5


@lru_cache(maxsize=512)
def signatures(robot: Robot, gait: Gait, motion: Motion, leg: int) -> FloatArray:
    """Change of lean in rad and contacts 0..1, (13, 8, 12): signatures, channels, parts of the cycle.

    The lean is positive if the body is lower ahead and on the left.
    """
    pattern, ticks = StepPattern.of(robot, gait), PARTS * _SAMPLES
    cycles = (np.arange(ticks) + 0.5) / ticks
    u = part_of_cycle(cycles[:, np.newaxis] + pattern.phases - pattern.phases[0])
    feet = feet_at_phases(robot, pattern, u, stroke_vectors_m(robot, gait, motion), 1.0)
    whole = solve_legs(robot, feet).joint_positions_rad
    joints = np.repeat(whole[np.newaxis], 1 + SIGNATURES, axis=0)  # intact, without load, locked
    joints[2:, :, leg_slice(leg)] = whole[::_SAMPLES, np.newaxis, leg_slice(leg)]
    carries: BoolArray = np.ones((*joints.shape[:-1], N_LEGS), dtype=bool)
    carries[1, :, leg - 1] = False
    slopes, forces_n = lean_and_forces(robot, joints, carries)
    touching = np.minimum(forces_n / (TOUCHES_SHARE * GRAVITY_M_S2 * robot.mass_kg), 1.0)
    seen = np.concatenate([np.arctan(slopes), touching], axis=-1)
    parts = seen.reshape(1 + SIGNATURES, PARTS, _SAMPLES, CHANNELS).mean(axis=2).swapaxes(1, 2)
    change: FloatArray = parts[1:] - parts[0]
    change.flags.writeable = False
    return change


class BodyBalance:
    """Evidence against each leg from lean and contacts, tick by tick; `cycles` of one tick.

    Args:
        signatures_of: signatures of a leg, 1..6, leading shape + (13, 8, 12); called for one leg in a tick.

    Attributes:
        ratio: evidence against each leg, an alarm at 1, leading shape + (6,).
        even: evenness of the floor, 1 to 0, a weight of other evidence, leading shape + (1,).
    """

    def __init__(
        self,
        shape: tuple[int, ...],
        period_s: float,
        cycles: FloatArray,
        signatures_of: Callable[[int], FloatArray],
    ) -> None:
        self._shape, self._period_s, self._cycles = shape, period_s, np.asarray(cycles)
        self._signatures_of = signatures_of
        self._signatures: list[FloatArray] = []
        self._ticks, self._some_paused = 0, False
        # A robot that returns to its gait learns nothing until it is settled: its leg may still fail.
        self._silent: BoolArray = np.zeros(shape, dtype=bool)
        self._paused: BoolArray = np.zeros(shape, dtype=bool)
        channels = (*shape, CHANNELS)
        # Last cycle, habit, and how often each part was seen.
        self._habit = PhaseHabit((3, *channels))
        self._changes_now: FloatArray = np.zeros((3, *channels))
        tick = np.broadcast_to(self._cycles[..., np.newaxis], channels)
        self._passed = PARTS * tick
        self._last_share, self._least_share = (1 - np.exp(-r * tick) for r in (LAST_CYCLE_RATE, HABIT_RATE))
        self._look_cycles = LOOK_TICKS * self._cycles[..., np.newaxis]
        self._floor_share = 1 - np.exp(-self._look_cycles / FLOOR_CYCLES)
        self._model = np.array([LEAN_RAD**2] * 2 + [CONTACT**2] * N_LEGS)
        self._variance: FloatArray = np.zeros(channels)
        self._lean_variance: FloatArray = np.full((*shape, 1), FIRST_VARIANCE)
        self._delay = np.round(FLOOR_DELAY_CYCLES / self._look_cycles[..., 0]).astype(int)
        self._before: FloatArray = np.full((int(self._delay.max()) + 1, *shape), FIRST_VARIANCE)
        self._look, self._known_cycles, self._floor_cycles = 0, np.zeros((*shape, 1)), np.zeros((*shape, 1))
        self._now: FloatArray = np.zeros((*shape, N_LEGS))
        self.even: FloatArray = np.ones((*shape, 1))
        self.ratio: FloatArray = np.zeros((*shape, N_LEGS))

    def update(self, state: RobotState, phases: FloatArray) -> None:
        """Take the state of a tick, and the normalised times of the legs then, leading shape + (6,)."""
        self._ticks += 1
        if len(self._signatures) < N_LEGS:
            self._add_signatures()
        if self._ticks * self._period_s < SETTLED_S:
            return
        seen = self._seen(state)
        late = (state.age_s + LAG_S) / self._period_s * self._cycles
        parts = cycle_parts((phases[..., 0] - late) % 1.0)
        last, usual, count = self._habit.at(parts[..., np.newaxis])
        changes, passed = self._changes_now, self._passed
        # A sum is finite only if every term is, and is cheaper than checking each term.
        if not math.isfinite(np.add.reduce(seen, axis=None)):
            known = np.isfinite(seen)
            seen, passed = np.where(known, seen, usual), passed * known
        if self._some_paused:
            passed = passed * ~self._paused[..., np.newaxis]
        np.subtract(seen, last, out=changes[0])
        np.subtract(seen, usual, out=changes[1])
        changes[0] *= np.where(count > 0, self._last_share, 1.0)
        changes[1] *= np.maximum(self._least_share, self._passed / (count + self._passed)) * (passed > 0)
        changes[2] = passed
        self._habit.learn(changes)
        if self._ticks % LOOK_TICKS == 0 and len(self._signatures) == N_LEGS:
            self._look_at_all()

    def silence(self, which: BoolArray | np.bool_) -> None:
        """Report nothing for some robots, leading shape, whose gait does not match the signatures."""
        self._silent = np.asarray(self._silent | which)
        self._stop_suspecting(which)

    def resume(self, which: BoolArray | np.bool_) -> None:
        """Watch robots, leading shape, that return to their gait; the habit is known."""
        self._silent = np.asarray(self._silent & ~which)
        self._stop_suspecting(which)

    def _stop_suspecting(self, which: BoolArray | np.bool_) -> None:
        robots = np.asarray(which)[..., np.newaxis]
        self._now, self.ratio = self._now * ~robots, self.ratio * ~robots
        self._known_cycles = self._known_cycles * ~robots
        self._paused, self._some_paused = np.asarray(self._paused | which), True

    def _add_signatures(self) -> None:
        self._signatures.append(self._signatures_of(len(self._signatures) + 1))
        if len(self._signatures) == N_LEGS:
            changes = np.concatenate(self._signatures, axis=-3)  # (..., 78, 8, 12)
            self._energies = np.add.reduce(changes * changes, axis=-1)
            self._changes = changes.reshape(*changes.shape[:-2], CHANNELS * PARTS)

    def _seen(self, state: RobotState) -> FloatArray:
        """Lean and contacts, leading shape + (8,), NaN if unknown."""
        seen: FloatArray = np.full((*self._shape, CHANNELS), np.nan)
        quaternion = state.base_quaternion_world
        if quaternion is not None:
            w, x, y, z = np.moveaxis(quaternion, -1, 0)
            seen[..., 0], seen[..., 1] = 2 * (w * y - x * z), -2 * (y * z + w * x)
        if state.foot_contacts is not None:
            seen[..., _FEET] = state.foot_contacts
        return seen

    def _look_at_all(self) -> None:
        last, usual, count = self._habit.values
        unusual = last - usual
        self._learn_floor(np.add.reduce(unusual * unusual, axis=-1) / PARTS)
        told = np.maximum.reduce(count, axis=-1) > 0
        weights = told / (self._model + FLOOR_TIMES * self._variance)
        weighted = (unusual * weights[..., np.newaxis]).reshape(*self._shape, CHANNELS * PARTS, 1)
        match = np.matmul(self._changes, weighted)[..., 0]
        energy = np.matmul(self._energies, weights[..., np.newaxis])[..., 0]
        size = np.minimum(np.maximum(match / np.maximum(energy, LEAST_ENERGY), LEAST_SIZE), MOST_SIZE)
        each = (size * (2 * match - size * energy)).reshape(*self._shape, N_LEGS, SIGNATURES)
        variance = self._lean_variance_before()
        self.even = np.where(told[..., :1], BUMPY_VARIANCE / (BUMPY_VARIANCE + variance), 1.0)
        ratio = self._ratio_of(np.maximum.reduce(each, axis=-1), variance)
        then, self._now = self._now, ratio * told[..., :1]
        self.ratio = np.minimum(then, self._now)

    def _ratio_of(self, evidence: FloatArray, variance: FloatArray) -> FloatArray:
        """Evidence over its threshold for a leg that exceeds all others, 0 for the others."""
        ranked = np.sort(evidence, axis=-1)
        best, second = ranked[..., -1:], np.maximum(ranked[..., -2:-1], 0.0)
        threshold = LEAST_EVIDENCE + FOR_VARIANCE * variance
        speaks = (self._known_cycles >= KNOWN_AFTER_CYCLES) & ~self._silent[..., np.newaxis]
        beats = (evidence >= best) & (best - second > BEATS_BY * best) & speaks
        return np.asarray(np.where(beats, np.maximum(evidence, 0.0), 0.0) / threshold)

    def _lean_variance_before(self) -> FloatArray:
        ago = (self._look - self._delay) % len(self._before)
        places = (ago, *np.indices(self._shape)) if self._shape else (int(ago),)
        return np.asarray(self._before[places])[..., np.newaxis]

    def _learn_floor(self, power: FloatArray) -> None:
        self._known_cycles = self._known_cycles + self._look_cycles
        if self._some_paused:
            self._paused = self._silent | (self._paused & (self._known_cycles[..., 0] < KNOWN_AFTER_CYCLES))
            self._some_paused = bool(self._paused.any())
        walks = ~self._paused[..., np.newaxis]
        walked = self._floor_cycles = self._floor_cycles + walks * self._look_cycles
        since = np.maximum(walked - FLOOR_AFTER, 0.0) + self._look_cycles
        power[..., _LEAN] = power[..., _LEAN].mean(axis=-1, keepdims=True)
        power[..., _FEET] = power[..., _FEET].mean(axis=-1, keepdims=True)
        learns = (walked > FLOOR_AFTER) & walks
        share = learns * np.maximum(self._floor_share, self._look_cycles / since)
        self._variance = self._variance + share * (power - self._variance)
        slower = learns * np.maximum(self._floor_share, self._look_cycles / (since + 1.0))
        self._lean_variance = self._lean_variance + slower * (power[..., :1] - self._lean_variance)
        self._look += 1
        self._before[self._look % len(self._before)] = self._lean_variance[..., 0]
