"""Body balance: which failure explains the lean of the body and the feet on the floor.

It is for servos that report no load. With D, the deviation of the last cycle from the habit in each
part of the cycle, in units of what is usual on this floor, learned signatures (`LegSignatures`) give the log
odds z_i that leg i failed rather than none. The evidence against a leg is its log odds against everything
else:

    q_i = z_i - log(1 + sum of exp(z_j) over the other legs j)

Bumps pass and failures stay: an alarm needs a mean of q, with a time constant of half a cycle, above a
threshold that grows with the logarithm of the deviations of the lean on this floor.
"""

import math
from collections.abc import Callable

import numpy as np

from hexctl.control.monitor.leg_signatures import SENSORS, LegSignatures
from hexctl.control.monitor.phase_habit import PARTS, PhaseHabit, cycle_parts
from hexctl.gait.foot_trajectory import RAMP_DURATION_S
from hexctl.types import N_LEGS, BoolArray, FloatArray, RobotState

#: Channels of the lean ahead and to the left; those of the contacts of the feet follow, if there are any.
LEAN_CHANNELS = 2

LAG_S = 0.03

#: After the soft start the body needs time to reach its habit.
SETTLED_S = RAMP_DURATION_S + 0.2

#: Learning rates of the last cycle and of the habit, per cycle, as in `PhaseHabit`.
LAST_CYCLE_RATE, HABIT_RATE = 24.0, 1.5

#: Variances of sensors and model, and initial ones on a floor, of the lean in rad^2 and of a contact.
MODEL = np.array([math.radians(0.05) ** 2, 0.15**2])
FIRST = np.array([math.radians(0.3) ** 2, 0.03])

#: Time constant of the variance on this floor in cycles, and the start of learning.
FLOOR_CYCLES, FLOOR_AFTER = 5.0, 1.0

#: Delay of that variance in cycles, which keeps a failure from hiding itself.
FLOOR_DELAY_CYCLES = 1.5

#: Added to mean squares of deviations: below, their logarithm and their pattern mean little.
LEAST_SIZE, LEAST_PATTERN = 0.3, 0.5

#: Time constant of the mean evidence in cycles, limit of the evidence, and least odds of all else.
EVIDENCE_CYCLES, MOST_EVIDENCE, LEAST_OTHERS = 0.5, 8.0, 1e-12

#: Evidence of an alarm, by what is seen, if the lean deviates on this floor as on one yet unknown; the least
#: logarithm of the deviations relative to it, and the evidence below an alarm that counts nothing.
ALARM, LEAST_FLOOR, SPAN = {"lean": 1.4, "contacts": 2.2}, -1.5, 4.0

#: Variance of the lean at which other evidence counts half.
BUMPY_VARIANCE = math.radians(0.3) ** 2

#: Cycles after which the habit is known, and ticks between two evaluations.
KNOWN_AFTER_CYCLES, LOOK_TICKS = 3.0, 5


class BodyBalance:
    """Evidence against each leg from lean and contacts, tick by tick; `cycles` of one tick.

    The first state decides whether contacts are used.

    Args:
        signatures_of: signatures, for one of `SENSORS`.
        patterns_of: patterns of a leg, 1..6, of what is seen, leading shape + (K, 2 or 8, 12), as
            `LegSignatures.of_leg` has them; called for one leg in a tick.

    Attributes:
        ratio: evidence against each leg, an alarm at 1, leading shape + (6,).
        even: evenness of the floor, 1 to 0, a weight of other evidence, leading shape + (1,).
        looked: what the last evaluation looked at: deviations of unit size, 24 or 96, sizes, 3 or 5, and 1,
            leading shape + (28 or 102,).
    """

    def __init__(
        self,
        shape: tuple[int, ...],
        period_s: float,
        cycles: FloatArray,
        signatures_of: Callable[[str], LegSignatures],
        patterns_of: Callable[[int, str], FloatArray],
    ) -> None:
        self._shape, self._period_s, self._cycles = shape, period_s, np.asarray(cycles)
        self._signatures_of, self._patterns_of = signatures_of, patterns_of
        self._patterns: list[FloatArray] = []
        self._ticks, self._some_paused, self._sensors = 0, False, ""
        # A robot that returns to its gait learns nothing until it is settled: its leg may still fail.
        self._silent: BoolArray = np.zeros(shape, dtype=bool)
        self._paused: BoolArray = np.zeros(shape, dtype=bool)
        self._look_cycles = LOOK_TICKS * self._cycles[..., np.newaxis]
        self._floor_share = 1 - np.exp(-self._look_cycles / FLOOR_CYCLES)
        self._delay = np.round(FLOOR_DELAY_CYCLES / self._look_cycles[..., 0]).astype(int)
        self._look, self._known_cycles, self._floor_cycles = 0, np.zeros((*shape, 1)), np.zeros((*shape, 1))
        self._evidence_share = 1 - np.exp(-self._look_cycles / EVIDENCE_CYCLES)
        self._evidence: FloatArray = np.full((*shape, N_LEGS), -MOST_EVIDENCE)
        self.even: FloatArray = np.ones((*shape, 1))
        self.ratio: FloatArray = np.zeros((*shape, N_LEGS))
        self.looked: FloatArray | None = None
        self._one = np.ones((*shape, 1))

    def _begin(self, contacts: bool) -> None:
        """Decide what is seen."""
        self._sensors = SENSORS[contacts]
        self._signatures = self._signatures_of(self._sensors)
        self._groups = np.repeat([0, 1], [LEAN_CHANNELS, N_LEGS * contacts])
        shape, kinds = (*self._shape, len(self._groups)), 1 + contacts
        # Last cycle, habit, and how often each part was seen.
        self._habit = PhaseHabit((3, *shape))
        self._seen_now: FloatArray = np.zeros(shape)
        self._changes_now: FloatArray = np.zeros((3, *shape))
        tick = np.broadcast_to(self._cycles[..., np.newaxis], shape)
        self._passed = PARTS * tick
        self._last_share, self._least_share = (1 - np.exp(-r * tick) for r in (LAST_CYCLE_RATE, HABIT_RATE))
        self._model, self._first = MODEL[:kinds], FIRST[:kinds]
        member = self._groups == np.arange(kinds)[:, np.newaxis]
        self._means_of = member / (PARTS * member.sum(axis=-1, keepdims=True))
        self._variance: FloatArray = np.broadcast_to(self._first, (*self._shape, kinds)).copy()
        self._before = np.stack([self._variance] * (int(self._delay.max()) + 1))

    def update(self, state: RobotState, phases: FloatArray) -> None:
        """Take the state of a tick, and the normalised times of the legs then, leading shape + (6,)."""
        if not self._sensors:
            self._begin(state.foot_contacts is not None)
        self._ticks += 1
        if len(self._patterns) < N_LEGS:
            self._patterns.append(self._patterns_of(len(self._patterns) + 1, self._sensors))
            if len(self._patterns) == N_LEGS:
                self._weights = self._all_weights()
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
        if self._ticks % LOOK_TICKS == 0 and len(self._patterns) == N_LEGS:
            self._look_at_all()

    def _all_weights(self) -> FloatArray:
        """Weights of what is looked at in the units of all legs, leading shape + (6 K, 28 or 102)."""
        patterns = np.concatenate(self._patterns, axis=-3)
        flat = patterns.reshape(*patterns.shape[:-2], -1)
        signatures = self._signatures
        others = np.tile(np.column_stack([signatures.sizes, signatures.biases]), (N_LEGS, 1))
        others = np.broadcast_to(others, (*flat.shape[:-1], others.shape[-1]))
        return np.ascontiguousarray(np.concatenate([flat, others], axis=-1))

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
        self._evidence = np.where(robots, -MOST_EVIDENCE, self._evidence)
        self.ratio = self.ratio * ~robots
        self._known_cycles = self._known_cycles * ~robots
        self._paused, self._some_paused = np.asarray(self._paused | which), True

    def _seen(self, state: RobotState) -> FloatArray:
        """Lean and contacts, leading shape + (2 or 8,), NaN if unknown."""
        seen, quaternion = self._seen_now, state.base_quaternion_world
        seen.fill(np.nan)
        if quaternion is not None:
            w, x, y, z = (quaternion[..., place] for place in range(4))  # faster than `moveaxis`
            seen[..., 0], seen[..., 1] = 2 * (w * y - x * z), -2 * (y * z + w * x)
        if state.foot_contacts is not None:
            seen[..., LEAN_CHANNELS:] = state.foot_contacts[..., : len(self._groups) - LEAN_CHANNELS]
        return seen

    def _look_at_all(self) -> None:
        last, usual, count = self._habit.values
        unusual = last - usual
        self._learn_floor(self._means(unusual * unusual))
        told = np.maximum.reduce(count[..., 0, :], axis=-1, keepdims=True) > 0
        variance = self._variance_before()
        self.even = np.where(told, BUMPY_VARIANCE / (BUMPY_VARIANCE + variance[..., :1]), 1.0)
        odds = self._log_odds(unusual, variance)
        now = np.minimum(np.maximum(odds, -MOST_EVIDENCE), MOST_EVIDENCE)  # faster than `clip`
        speaks = told & (self._known_cycles >= KNOWN_AFTER_CYCLES) & ~self._silent[..., np.newaxis]
        mean = self._evidence + self._evidence_share * (now - self._evidence)
        self._evidence = np.where(speaks, mean, -MOST_EVIDENCE)
        floor = np.maximum(0.5 * np.log(variance[..., :1] / self._first[0]), LEAST_FLOOR)
        alarm = ALARM[self._sensors] + floor
        self.ratio = np.maximum(1.0 + (self._evidence - alarm) / SPAN, 0.0)

    def _means(self, squares: FloatArray) -> FloatArray:
        """Means over lean and over contacts, leading shape + (1 or 2,)."""
        sums = np.add.reduce(squares, axis=-1)[..., np.newaxis, :]
        return np.asarray(np.add.reduce(sums * self._means_of, axis=-1))

    def _log_odds(self, unusual: FloatArray, variance: FloatArray) -> FloatArray:
        """Log odds of each leg against everything else, leading shape + (6,)."""
        self.looked = self._looked(unusual, variance)
        units = np.tanh(np.matmul(self._weights, self.looked[..., np.newaxis])[..., 0])
        outputs = self._signatures.outputs
        units = units.reshape(*self._shape, N_LEGS, len(outputs) - 1)
        odds = np.add.reduce(units * outputs[:-1], axis=-1) + outputs[-1]
        most = np.maximum(np.maximum.reduce(odds, axis=-1, keepdims=True), 0.0)
        shares = np.exp(odds - most)
        total = np.add.reduce(shares, axis=-1, keepdims=True) + np.exp(-most)
        others = np.maximum(total - shares, LEAST_OTHERS)
        return np.asarray(odds - most - np.log(others))

    def _looked(self, unusual: FloatArray, variance: FloatArray) -> FloatArray:
        """What is looked at, leading shape + (28 or 102,)."""
        units = unusual / np.sqrt(self._model + variance)[..., self._groups][..., np.newaxis]
        powers = self._means(units * units)
        learned = self._floor_cycles - FLOOR_AFTER - FLOOR_DELAY_CYCLES
        power = np.add.reduce(powers, axis=-1)[..., np.newaxis, np.newaxis]
        looked = [
            (units / np.sqrt(LEAST_PATTERN + power)).reshape(*self._shape, -1),
            np.log(LEAST_SIZE + powers),
            0.5 * np.log(variance / self._first),
            np.log(1.0 + np.maximum(learned, 0.0)),
            self._one,
        ]
        return np.concatenate(looked, axis=-1)

    def _variance_before(self) -> FloatArray:
        ago = (self._look - self._delay) % len(self._before)
        places = (ago, *np.indices(self._shape)) if self._shape else (int(ago),)
        return np.asarray(self._before[places])

    def _learn_floor(self, powers: FloatArray) -> None:
        self._known_cycles = self._known_cycles + self._look_cycles
        if self._some_paused:
            self._paused = self._silent | (self._paused & (self._known_cycles[..., 0] < KNOWN_AFTER_CYCLES))
            self._some_paused = bool(self._paused.any())
        walks = ~self._paused[..., np.newaxis]
        walked = self._floor_cycles = self._floor_cycles + walks * self._look_cycles
        since = np.maximum(walked - FLOOR_AFTER, 0.0) + self._look_cycles
        learns = (walked > FLOOR_AFTER) & walks
        # The initial variance counts as one cycle.
        share = learns * np.maximum(self._floor_share, self._look_cycles / (since + 1.0))
        self._variance = self._variance + share * (powers - self._variance)
        self._look += 1
        self._before[self._look % len(self._before)] = self._variance
