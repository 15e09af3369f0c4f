"""The leg monitor: detects which leg has failed in mid-walk, and how."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexctl.control.monitor.body_balance import BodyBalance
from hexctl.control.monitor.dead_legs import DeadLegs
from hexctl.control.monitor.joint_following import JointFollowing
from hexctl.control.monitor.joint_stiffness import BLOCK_TICKS, JointStiffness
from hexctl.control.monitor.leg_signatures import shipped_signatures
from hexctl.control.monitor.leg_support import NO_TORQUE_SHARE, LegSupport
from hexctl.control.monitor.phase_habit import cycle_parts
from hexctl.control.monitor.recent_motion import STILL_CYCLES, TAKES_PART, RecentMotion, failure_shown
from hexctl.robot.failure import UNKNOWN, Failure, in_words_with_share
from hexctl.robot.model import Robot
from hexctl.types import (
    JOINT_KINDS,
    JOINTS_PER_LEG,
    N_JOINTS,
    N_LEGS,
    BoolArray,
    FloatArray,
    RobotState,
    leg_slice,
)

#: Rho of a failed joint, and the added multiple of the robot's usual rho.
LEAST_RHO, TIMES_USUAL = 0.2, 2.5

#: Missing share of load of a failed leg, the added multiple of other legs' maximum, and the limit of the sum.
LEAST_MISSING, TIMES_MISSING, MOST_MISSING = 0.6, 0.6, 0.99

#: Idle cycles of a joint without power, and the added multiple of another leg's maximum.
LEAST_IDLE, TIMES_IDLE = 0.14, 1.0

#: Time constants in cycles of the usual rho, of other legs and of the leg itself (slower: a failure must not
#: raise its own threshold), and the initial rho.
USUAL_CYCLES, OWN_CYCLES, FIRST_RHO = 1.5, 3.0, 0.8

#: Time constant in cycles of other legs' maximum, and initial values of missing load and idle cycles.
MOST_CYCLES, FIRST_MISSING, FIRST_IDLE = 6.0, 0.6, 0.1

#: If this many legs lag at the same time, the robot is overloaded: the multiple of the smallest rho of them
#: that is added to the threshold, and its time constant in cycles.
MANY, TIMES_MANY, MANY_CYCLES = 3, 6.0, 3.0

#: Consecutive ticks of an alarm, and cycles on uneven ground, which may block a leg for a step.
ALARM_TICKS, UNEVEN_CYCLES = 3, 1.0

#: In motions that change at will feet land at other times than usual. With echoed targets a leg then misses
#: its load only after so many cycles without any contact; after fewer, healthy legs were accused.
LIFTED_CYCLES = 2.0

#: Ticks between updates of the usual evidence.
LEARNING_TICKS = 4

#: Kinds of evidence, in the order of the monitor's arrays.
EVIDENCE = ("following", "support", "effort", "balance", "start", "silence")

#: Evidence of a weak joint: no alarm, the leg is used as before.
STIFFNESS = "stiffness"

#: Evidence that shows once and for all how a leg failed, or never.
SETTLED = ("balance", "start", "silence")

#: A leg has failed if its servo is silent for this much longer than usual; if `MANY` legs are, it is the bus.
SILENT_S = 0.5

#: A jump by this multiple of a joint's maximum step plus this angle is an outlier, at most so often in a row.
WILD_TIMES, WILD_RAD, MOST_WILD = 3.0, 0.1, 2

#: Number of kinds of evidence compared with usual values here; the balance does so itself.
_ROWS = 3

_EFFORT, _START, _SILENCE = (EVIDENCE.index(name) for name in ("effort", "start", "silence"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Suspicion:
    """A suspected failure of a leg at a step; the angle of a stuck joint is the one measured.

    Attributes:
        evidence: one of `EVIDENCE`, or `STIFFNESS`; silence, and balance with echoed joints, show no kind.
        ratio: evidence over its threshold, above 1.
        error: standard deviation of the torque fraction of a weak joint; None for other kinds.
    """

    failure: Failure
    step: int
    evidence: str
    ratio: float
    error: float | None = None

    @property
    def leg(self) -> int:
        """Leg number, 1..6."""
        return self.failure.leg

    def __str__(self) -> str:
        return f"leg {self.leg} {in_words_with_share(self.failure, self.error)}"


class LegMonitor:
    """Detects failed legs of a walk, or of n of them, from measurements only.

    Robots of a batch are simulated: all of them measure torques, or none. Legs have the leading shape + (6,).

    Args:
        known: known failed legs; they are not watched.
        patterns_of: as `BodyBalance` has it; None leaves the balance out.
        uneven: whether the ground may block legs: alarms need a cycle, and joints are not checked for
            weakness.

    Attributes:
        failed: legs that it assumes to have failed.
        new: legs detected in the last tick.
        ratio: evidence against each leg, an alarm at 1.
        weakened: whether joints were found weak in the last tick.
    """

    def __init__(
        self,
        robot: Robot,
        shape: tuple[int, ...],
        period_s: float,
        pace_hz: FloatArray,
        known: BoolArray | None = None,
        patterns_of: Callable[[int, str], FloatArray] | None = None,
        *,
        uneven: bool = False,
    ) -> None:
        legs = (*shape, N_LEGS)
        cycles = np.asarray(pace_hz * period_s)
        patience_ticks = np.rint(uneven * UNEVEN_CYCLES / cycles)[..., np.newaxis]
        self._uneven, self._alarm_needs = uneven, np.maximum(ALARM_TICKS, patience_ticks)
        self._none_nm = NO_TORQUE_SHARE * robot.joint_max_torque_nm
        self._wild_rad = WILD_TIMES * robot.joint_max_speed_rad_s * period_s + WILD_RAD
        self._before_rad: FloatArray | None = None
        self._never_wild: NDArray[np.int64] = np.zeros((*shape, N_JOINTS), dtype=np.int64)
        self._wild_ticks = self._never_wild
        self._following = JointFollowing(shape, period_s, cycles, robot.joint_max_torque_nm)
        self._support = LegSupport(shape, cycles)
        self._dead = DeadLegs(shape, period_s, cycles)
        # Rows as in EVIDENCE: maximum rho of each leg, missing load, longest idle joint.
        self._evidence: FloatArray = np.zeros((_ROWS, *legs))
        # Compared values: the robot's usual rho, the recent maximum of another leg.
        self._compared = _of_each(legs, FIRST_RHO, FIRST_MISSING, FIRST_IDLE)
        self._most_seen = self._compared[1:].copy()
        ticks_in_cycles = np.broadcast_to((LEARNING_TICKS * cycles)[..., np.newaxis], legs).copy()
        constants = np.array([USUAL_CYCLES, OWN_CYCLES]).reshape(2, *([1] * len(legs)))
        self._usual_shares = np.minimum(1.0, ticks_in_cycles / constants)
        # Usual rho of a leg for comparison with other legs, and with itself.
        self._usual_rho = _first_usual(legs)
        self._kept = np.exp(-ticks_in_cycles / MOST_CYCLES)
        self._many_kept = np.exp(-ticks_in_cycles[..., :1] / MANY_CYCLES)
        places = np.arange(self._most_seen.size).reshape(self._most_seen.shape)
        self._others = np.stack([np.roll(places, by, axis=-1) for by in range(1, N_LEGS)])
        self._other_legs = self._others[:, 0].copy()
        self._least = _of_each(legs, LEAST_RHO, LEAST_MISSING, LEAST_IDLE)
        self._times = _of_each(legs, TIMES_USUAL, TIMES_MISSING, TIMES_IDLE)
        self._most = _of_each(legs, np.inf, MOST_MISSING, np.inf)
        self._ticks, self._alarm_ticks, self._measured = 0, np.zeros(legs, dtype=int), False
        self._alarm, self._suspected = np.ones(legs), False
        self._lifted_cycles: FloatArray = np.zeros(legs)
        self._cycles, self._motion = cycles, RecentMotion(shape, cycles)
        self._stiffness = JointStiffness(shape, robot.joint_max_torque_nm)
        self._all_heard, self.weakened = True, False
        self.failed: BoolArray = np.zeros(legs, dtype=bool) if known is None else known.copy()
        self._watched = np.where(self.failed, 0.0, 1.0)
        none: BoolArray = np.zeros(legs, dtype=bool)
        self._support.forget(none[..., :1], none, ~self.failed)
        self.new: BoolArray = np.zeros(legs, dtype=bool)
        self.ratio: FloatArray = np.zeros(legs)
        self._ratios: FloatArray = np.zeros((len(EVIDENCE), *legs))
        self._compared_ratios, self._effort_ratio = self._ratios[:_ROWS], self._ratios[_EFFORT]
        self._rho_of_many: FloatArray = np.zeros((*shape, 1))
        self._balance: BodyBalance | None = None
        if patterns_of is not None:
            self._balance = BodyBalance(
                shape, period_s, cycles, lambda seen: shipped_signatures()[seen], patterns_of
            )
            self._balance.silence(self.failed.any(axis=-1))
        self._period_s, self._silent_s, self._some_silent = period_s, np.zeros(legs), False
        self._parts: NDArray[np.int64] = np.zeros(legs, dtype=np.int64)
        self._gait_kept: BoolArray = np.ones(shape, dtype=bool)
        self._set_threshold()
        self._threshold_then = self._threshold  # at the last alarm

    def update(self, state: RobotState, phases: FloatArray) -> None:
        """Take the state of a tick, and the normalised times of the legs then, leading shape + (6,)."""
        state = self._without_wild(state)
        torques_nm = state.joint_torques_nm
        if torques_nm is not None:
            # A sum is finite only if every term is, and cheaper than checking each; for one robot without
            # NumPy.
            one = torques_nm.ndim == 1
            total_nm = sum(torques_nm.tolist()) if one else np.add.reduce(torques_nm, axis=None)
            # Servos do not all lose power and keep their positions: torques are not reported.
            if not math.isfinite(total_nm) or (total_nm == 0 and not torques_nm.any()):
                state = replace(state, joint_torques_nm=None)
        if (stale := state.stale_joints) is not None:
            expected_rad = np.where(stale, self._following.expected_rad, state.joint_positions_rad)
            state = replace(state, joint_positions_rad=expected_rad)
        self._measured, parts = state.measured, self._parts_at(phases)
        size_nm = None if state.joint_torques_nm is None else np.abs(state.joint_torques_nm)
        idle = None if size_nm is None else size_nm < self._none_nm
        if state.measured:
            self._following.update(state, parts, size_nm)
            if size_nm is not None and self._balance is not None:
                self._balance, self._ratios[_ROWS] = None, 0.0  # loads show more
        if self._balance is not None:
            self._balance.update(state, phases)
        self._support.update(state, parts, self._following if state.measured else None, size_nm, idle)
        self._motion.measured(state.joint_positions_rad, state.joint_torques_nm)
        self._evidence[0] = self._following.rho_of_legs
        self._evidence[1] = self._support.missing
        self._evidence[2] = self._support.idle_of_legs
        np.divide(self._evidence, self._threshold, out=self._compared_ratios)
        if self._balance is not None:
            self._ratios[_ROWS] = self._balance.ratio
            if not state.measured and state.joint_torques_nm is None:
                # Feet hang in the air on a bumpy floor.
                self._ratios[1] *= self._balance.even
        elif not state.measured and state.foot_contacts is not None:
            self._lifted_cycles = (self._lifted_cycles + self._cycles[..., np.newaxis]) * ~state.foot_contacts
            self._ratios[1] *= self._lifted_cycles >= LIFTED_CYCLES
        self._dead.update(state, idle, self._following if self._ticks else None)
        np.maximum(self._effort_ratio, self._dead.idle, out=self._effort_ratio)
        self._ratios[_START] = self._dead.start
        self._listen(stale)
        self.ratio = np.maximum.reduce(self._ratios) * self._watched
        self._ticks += 1
        if self._ticks % LEARNING_TICKS == 0:
            self._learn_usual()
        self._count_alarms()
        self._all_heard &= state.stale_joints is None
        self.weakened = False
        if self._ticks % BLOCK_TICKS == 0:
            self._compare_stiffness(state)

    def rests(self, state: RobotState) -> None:
        """Take the state of a tick in which no leg steps: motion until the next step is no jump."""
        state = self._without_wild(state)
        self._motion.measured(state.joint_positions_rad, state.joint_torques_nm)

    def sent(self, targets_rad: FloatArray, age_s: float = 0.0) -> None:
        """Take the targets sent in the tick, leading shape + (18,), after a state of an age."""
        self._following.sent(targets_rad, age_s)
        self._motion.sent(targets_rad)

    def hurry(self, haste: FloatArray) -> None:
        """Take the multiple of the pace at which robots walk now, leading shape, at least 1."""
        self._motion.cycles = self._cycles * haste

    def believe_whole(self, leg: int, row: tuple[int, ...] = ()) -> None:
        """Watch a leg, 1..6, again, with the high thresholds of the start of a walk."""
        self.failed[(*row, leg - 1)] = False
        changed: BoolArray = np.zeros_like(self.failed[..., :1])
        changed[row] = True
        taken_back: BoolArray = np.zeros_like(self.failed)
        taken_back[(*row, leg - 1)] = True
        self._dead.forget(leg, row)
        # The usual load of that leg is known from before.
        self._be_patient(changed, anew=changed & ~taken_back)
        if self._balance is not None:
            back = changed[..., 0] & self._gait_kept & ~self.failed.any(axis=-1)
            self._balance.resume(back)

    def believe_failed(self, leg: int, row: tuple[int, ...] = ()) -> None:
        """Stop watching a leg, 1..6."""
        self.failed[(*row, leg - 1)] = True
        self._watched = np.where(self.failed, 0.0, 1.0)

    def gait_changes(self, which: BoolArray) -> None:
        """Raise thresholds of some robots, leading shape, whose usual values no longer hold."""
        self._gait_kept = self._gait_kept & ~which
        self._be_patient(which[..., np.newaxis])

    def suspicion(self, step: int, row: tuple[int, ...] = ()) -> Suspicion:
        """The suspicion of the leg detected in the last tick, of one robot of a batch."""
        leg = int(np.argmax(self.new[row])) + 1
        ratios: tuple[Any, ...] = (slice(None), *row, leg - 1)
        evidence = EVIDENCE[int(np.argmax(self._ratios[ratios]))]
        failure = self._dead.kind(leg, row) if evidence == "start" else self.kind(leg, row)
        unknown = evidence == "silence" or (evidence == "balance" and not self._measured)
        return Suspicion(
            failure=Failure(leg=leg, kind=UNKNOWN) if unknown else failure,
            step=step,
            evidence=evidence,
            ratio=float(self.ratio[row][leg - 1]),
        )

    def weak_joints(self, step: int, row: tuple[int, ...] = ()) -> list[Suspicion]:
        """Joints found weak in the last tick, of one robot of a batch."""
        found = []
        for joint in np.flatnonzero(self._stiffness.new[row]).tolist():
            leg, kind = divmod(joint, JOINTS_PER_LEG)
            share, error = (
                float(one[(*row, joint)]) for one in (self._stiffness.share, self._stiffness.error)
            )
            failure = Failure(leg=leg + 1, kind="weak", joint=JOINT_KINDS[kind], torque_fraction=share)
            found.append(Suspicion(failure=failure, step=step, evidence=STIFFNESS, ratio=1.0, error=error))
        return found

    def silent(self, leg: int, row: tuple[int, ...] = ()) -> bool:
        """Whether a servo of a leg, 1..6, is silent now, of one robot of a batch."""
        return bool(self._silent_s[row][leg - 1] > 0)

    def _parts_at(self, phases: FloatArray) -> NDArray[np.int64]:
        """Parts of the cycle of the legs; the same array until one of them changes, which saves look-ups."""
        parts = cycle_parts(phases)
        if parts.tobytes() != self._parts.tobytes():
            self._parts = parts
        return self._parts

    def _without_wild(self, state: RobotState) -> RobotState:
        """State in which a joint with an outlier keeps its angle from before, for `MOST_WILD` ticks."""
        measured_rad, before_rad = state.joint_positions_rad, self._before_rad
        self._before_rad = measured_rad
        if before_rad is None:
            return state
        jumps = np.abs(measured_rad - before_rad) > self._wild_rad
        if not np.count_nonzero(jumps):
            self._wild_ticks = self._never_wild
            return state
        self._wild_ticks = (self._wild_ticks + 1) * jumps
        wild = jumps & (self._wild_ticks <= MOST_WILD)
        self._before_rad = np.where(wild, before_rad, measured_rad)
        return replace(state, joint_positions_rad=self._before_rad)

    def _listen(self, stale: BoolArray | None) -> None:
        """Count how long legs have had a silent servo; other evidence of them is then void."""
        if stale is None:
            if self._some_silent:
                self._silent_s[...], self._ratios[_SILENCE], self._some_silent = 0.0, 0.0, False
            return
        legs = stale.reshape(*self.ratio.shape, JOINTS_PER_LEG).any(axis=-1)
        self._silent_s, self._some_silent = (self._silent_s + self._period_s) * legs, True
        few = np.count_nonzero(legs, axis=-1, keepdims=True) < MANY
        self._ratios[:_SILENCE] *= ~legs
        self._ratios[_SILENCE] = few * self._silent_s / SILENT_S

    def _compare_stiffness(self, state: RobotState) -> None:
        known = state.measured and state.joint_torques_nm is not None and self._all_heard
        if known and not self._uneven:
            self._stiffness.update(self._motion, round(state.age_s / self._period_s), ~self.failed)
            self.weakened = bool(np.count_nonzero(self._stiffness.new))
        self._all_heard = True

    def _learn_usual(self) -> None:
        rho = self._evidence[0] * self._watched
        change = self._usual_shares * (rho - self._usual_rho)
        # A leg must not raise its own threshold during a long alarm.
        self._usual_rho += change * (self._alarm_ticks == 0) if self._uneven else change
        # The smallest rho of `MANY` legs: legs do not all fail at the same time.
        rho.partition(N_LEGS - MANY, axis=-1)
        of_many = rho[..., N_LEGS - MANY, np.newaxis]
        self._rho_of_many = np.maximum(self._rho_of_many * self._many_kept, of_many)
        self._most_seen = np.maximum(self._most_seen * self._kept, self._evidence[1:]) * self._watched
        self._compared[1:] = np.maximum.reduce(self._most_seen.take(self._others))
        of_others, own = self._usual_rho
        self._compared[0] = np.maximum(np.maximum.reduce(of_others.take(self._other_legs)), own)
        self._set_threshold()

    def _set_threshold(self) -> None:
        self._threshold = np.minimum(self._least + self._times * self._compared, self._most)
        self._threshold[0] += TIMES_MANY * self._rho_of_many

    def _count_alarms(self) -> None:
        over = self.ratio > self._alarm
        before, self._suspected = self._suspected, bool(np.count_nonzero(over))
        if not (before or self._suspected):
            return
        self._alarm_ticks = (self._alarm_ticks + 1) * over
        self.new = self._alarm_ticks >= self._alarm_needs
        if self.new.any():
            # One leg at a time: consequences of its failure must not be blamed on another.
            self.new &= self.ratio >= self.ratio.max(axis=-1, keepdims=True)
            self.new &= np.cumsum(self.new, axis=-1) == 1  # of equal ones the first
            self._accept()

    def _accept(self) -> None:
        self.failed = self.failed | self.new
        changed = np.logical_or.reduce(self.new, axis=-1, keepdims=True)
        self._threshold_then = np.where(changed, self._threshold, self._threshold_then)
        self._be_patient(changed)

    def _be_patient(self, changed: BoolArray, anew: BoolArray | None = None) -> None:
        """Raise thresholds while the gait of some robots changes, leading shape + (1,).

        The usual load is learned again for legs `anew`, leading shape + (6,), or for all.
        """
        self._watched = np.where(self.failed, 0.0, 1.0)
        patient = _of_each(self.new.shape, FIRST_RHO, MOST_MISSING, 2 * FIRST_IDLE)
        self._compared = np.where(changed, patient, self._compared)
        self._most_seen = np.where(changed, patient[1:], self._most_seen)
        self._usual_rho = np.where(changed, _first_usual(self.new.shape), self._usual_rho)
        self._set_threshold()
        self._following.forget(changed)
        if self._balance is not None:
            self._balance.silence(changed[..., 0])
        anew = changed if anew is None else anew
        self._support.forget(changed, anew & ~self.failed, ~self.failed)
        self._alarm_ticks = self._alarm_ticks * ~changed

    def kind(
        self, leg: int, row: tuple[int, ...] = (), *, cycles: float = STILL_CYCLES, powered: bool = False
    ) -> Failure:
        """How leg 1..6 fails by the last cycles, up to `MOST_STILL_CYCLES`, as in `failure_shown`."""
        rho = self._following.rho[row][leg_slice(leg)]
        quiet = rho.max() < TAKES_PART * self._threshold_then[(0, *row, leg - 1)]
        return failure_shown(
            leg,
            self._motion.of_leg(leg, row, cycles=cycles),
            rho,
            follows=bool(quiet and self._dead.follows[(*row, leg - 1)]),
            none_nm=self._none_nm[leg_slice(leg)],
            powered=powered,
        )


def _first_usual(legs: tuple[int, ...]) -> FloatArray:
    return np.stack([np.full(legs, FIRST_RHO), np.zeros(legs)])


def _of_each(legs: tuple[int, ...], *values: float) -> FloatArray:
    """Values for each kind of evidence, of all legs, (3,) + legs."""
    return np.stack([np.full(legs, value) for value in values])
