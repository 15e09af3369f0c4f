"""The leg monitor: says in mid-walk which leg has failed, and how."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hexctl.control.monitor.joint_following import JointFollowing
from hexctl.control.monitor.leg_support import LegSupport
from hexctl.control.monitor.phase_habit import cycle_parts
from hexctl.robot.failure import Failure
from hexctl.robot.failure_event import in_words
from hexctl.robot.model import Robot
from hexctl.types import (
    JOINT_KINDS,
    N_JOINTS,
    N_LEGS,
    BoolArray,
    FloatArray,
    RobotState,
    leg_slice,
)

#: Rho above which a joint has failed, and how many times what is usual for the robot is added.
LEAST_RHO, TIMES_USUAL = 0.2, 2.5

#: Share of its load that a leg misses when it has gone, and how many times its own usual is added.
LEAST_MISSING, TIMES_MISSING = 0.6, 1.0

#: More than this share cannot be asked for.
MOST_MISSING = 0.97

#: Time constant of what is usual, in cycles, and what it is taken for before anything is known.
USUAL_CYCLES, FIRST_RHO, FIRST_MISSING = 1.5, 0.8, 0.4

#: An alarm needs this many ticks in a row.
ALARM_TICKS = 3

#: Ticks after which it is learned how much evidence is usual.
LEARNING_TICKS = 2

#: Time over which a joint is looked at to tell a still one from one that moves, in cycles.
STILL_CYCLES = 0.25

#: A joint is still if it moves by less than this, or by this share of its targets.
STILL_RAD, STILL_SHARE = np.radians(2.0), 0.25

#: Targets that move by less than this do not tell whether a joint is still.
TELLING_RAD = np.radians(4.0)

#: A servo with less than this share of its greatest torque does not drive a joint that is off its target. The
#: joints of a locked leg in the air hold its weight, with some percent.
DEAD_SHARE = 0.005

#: A joint takes part in a failure if its evidence is this share of an alarm, or of the worst joint's.
TAKES_PART = 0.4


@dataclass(frozen=True, slots=True, kw_only=True)
class Suspicion:
    """What the monitor believes of a leg.

    Attributes:
        failure: leg, kind and joint; the angle of a stuck joint is the one measured.
        step: of the walk, when it was noticed.
        evidence: what it was noticed by: `following`, its joints' targets, or `support`, its load.
        ratio: evidence over its threshold, above 1.
    """

    failure: Failure
    step: int
    evidence: str
    ratio: float

    @property
    def leg(self) -> int:
        """The leg."""
        return self.failure.leg

    def __str__(self) -> str:
        return f"leg {self.leg} {in_words(self.failure)}"


class LegMonitor:
    """Watches a walk, or n of them: which legs have failed, from what is measured alone.

    Args:
        robot: whose servos say how large a torque is.
        shape: leading shape.
        period_s: control period.
        pace_hz: of the gait, leading shape.
        believed: legs that are known to have failed, leading shape + (6,); they are not watched.

    Attributes:
        failed: legs that it believes to have failed, leading shape + (6,).
        new: legs noticed in the last tick, leading shape + (6,).
        ratio: how far the evidence against each leg is, alarm at 1, leading shape + (6,).
    """

    def __init__(
        self,
        robot: Robot,
        shape: tuple[int, ...],
        period_s: float,
        pace_hz: FloatArray,
        believed: BoolArray | None = None,
    ) -> None:
        legs = (*shape, N_LEGS)
        cycles = np.asarray(pace_hz * period_s)
        self._dead_nm = DEAD_SHARE * robot.joint_max_torque_nm
        self._following = JointFollowing(shape, period_s, cycles, robot.joint_max_torque_nm)
        self._support = LegSupport(shape, cycles)
        # Two kinds of evidence: of joints, the greatest rho of each leg, and the load that each leg misses.
        self._evidence: FloatArray = np.zeros((2, *legs))
        self._now: FloatArray = np.zeros((2, *legs))
        self._usual = _of_both(legs, FIRST_RHO, FIRST_MISSING)
        share = np.minimum(1.0, LEARNING_TICKS * cycles / USUAL_CYCLES)
        self._usual_share = np.broadcast_to(share[..., np.newaxis], (2, *legs)).copy()
        self._least = _of_both(legs, LEAST_RHO, LEAST_MISSING)
        self._times = _of_both(legs, TIMES_USUAL, TIMES_MISSING)
        self._most = _of_both(legs, np.inf, MOST_MISSING)
        self._ticks, self._alarm_ticks = 0, np.zeros(legs, dtype=int)
        self._alarm, self._suspected = np.ones(legs), False
        self._still_ticks = np.maximum(2, np.rint(STILL_CYCLES / cycles).astype(int))
        self._history: FloatArray = np.full((3, int(self._still_ticks.max()), *shape, N_JOINTS), np.nan)
        self._row = 0
        self.failed: BoolArray = np.zeros(legs, dtype=bool) if believed is None else believed.copy()
        self._watched = np.where(self.failed, 0.0, 1.0)
        self.new: BoolArray = np.zeros(legs, dtype=bool)
        self.ratio: FloatArray = np.zeros(legs)
        self._following_ratio: FloatArray = np.zeros(legs)
        self._set_threshold()

    def update(self, state: RobotState, phases: FloatArray) -> None:
        """Take the state of a tick, and the normalised times of the legs then, leading shape + (6,)."""
        torques_nm = state.joint_torques_nm
        # A sum is finite only if every term is, and is cheaper than asking each one.
        if torques_nm is not None and not math.isfinite(np.add.reduce(torques_nm, axis=None)):
            state = replace(state, joint_torques_nm=None)
        parts = cycle_parts(phases)
        if state.measured:
            self._following.update(state, parts)
        self._support.update(state, parts)
        self._history[0, self._row] = state.joint_positions_rad
        if state.joint_torques_nm is not None:
            self._history[2, self._row] = state.joint_torques_nm
        self._evidence[0] = self._following.rho_of_legs
        self._evidence[1] = self._support.missing
        ratio = self._evidence / self._threshold
        self._following_ratio = ratio[0]
        self.ratio = np.maximum(ratio[0], ratio[1]) * self._watched
        self._ticks += 1
        if self._ticks % LEARNING_TICKS == 0:
            self._learn_usual()
        self._count_alarms()

    def sent(self, targets_rad: FloatArray, age_s: float = 0.0) -> None:
        """Take the targets sent in the tick, leading shape + (18,), after a state of an age."""
        self._following.sent(targets_rad, age_s)
        self._history[1, self._row] = targets_rad
        self._row = (self._row + 1) % self._history.shape[1]

    def believe_whole(self, leg: int, row: tuple[int, ...] = ()) -> None:
        """Watch a leg again, 1..6, patiently as at the start of a walk."""
        self.failed[(*row, leg - 1)] = False
        changed: BoolArray = np.zeros_like(self.failed[..., :1])
        changed[row] = True
        self._be_patient(changed)

    def suspicion(self, step: int, row: tuple[int, ...] = ()) -> Suspicion:
        """What is believed of the leg that was noticed in the last tick, of one robot of a batch."""
        leg = int(np.argmax(self.new[row]))
        # A leg that is gone follows all the better.
        by_support = self._following_ratio[row][leg] < TAKES_PART
        failure = Failure(leg=leg + 1, kind="missing") if by_support else self.kind(leg + 1, row)
        evidence = "support" if by_support else "following"
        return Suspicion(failure=failure, step=step, evidence=evidence, ratio=float(self.ratio[row][leg]))

    def _learn_usual(self) -> None:
        """Follow what is usual: the greatest rho of all joints of a robot, and what each leg misses."""
        watched_rho = self._following.rho_of_legs * self._watched
        self._now[0] = np.maximum.reduce(watched_rho, axis=-1, keepdims=True)
        self._now[1] = self._support.missing
        self._usual += self._usual_share * (self._now - self._usual)
        self._set_threshold()

    def _set_threshold(self) -> None:
        self._threshold = np.minimum(self._least + self._times * self._usual, self._most)

    def _count_alarms(self) -> None:
        """Count for how many ticks each leg has been suspected, and accept those that were for long."""
        over = self.ratio > self._alarm
        before, self._suspected = self._suspected, bool(np.count_nonzero(over))
        if not (before or self._suspected):
            return
        self._alarm_ticks = (self._alarm_ticks + 1) * over
        self.new = self._alarm_ticks >= ALARM_TICKS
        if self.new.any():
            # One leg at a time: what follows from its failure must not be blamed on another.
            self.new &= self.ratio >= self.ratio.max(axis=-1, keepdims=True)
            self._accept()

    def _accept(self) -> None:
        """Count the new legs as failed, and be patient while the gait changes."""
        self.failed = self.failed | self.new
        self._be_patient(np.logical_or.reduce(self.new, axis=-1, keepdims=True))

    def _be_patient(self, changed: BoolArray) -> None:
        """Ask for more evidence while the gait of some robots changes, leading shape + (1,)."""
        self._watched = np.where(self.failed, 0.0, 1.0)
        patient = _of_both(self.new.shape, FIRST_RHO, 2 * FIRST_MISSING)
        self._usual = np.where(changed, patient, self._usual)
        self._set_threshold()
        self._following.forget(changed)
        self._support.forget(changed)
        self._alarm_ticks = self._alarm_ticks * ~changed

    def kind(self, leg: int, row: tuple[int, ...] = ()) -> Failure:
        """How the joints of a leg fail, 1..6, as far as the last quarter of a cycle tells.

        Without torque they are limp. A joint whose target moves and that does not is still: one alone is
        stuck, all are locked.
        """
        joints = leg_slice(leg)
        # The newest rows: measured in this tick, sent in the one before.
        newest = (self._row - np.arange(self._still_ticks[row])) % self._history.shape[1]
        index: tuple[Any, ...] = (*row, joints)
        measured_rad, torques_nm = (self._history[part][(newest, *index)] for part in (0, 2))
        targets_rad = self._history[1][((newest - 1) % self._history.shape[1], *index)]
        rho = self._following.rho[row][joints]
        worst = int(np.argmax(rho))
        recent_nm = torques_nm[: 1 + len(torques_nm) // 2]
        dead = np.abs(recent_nm).max(axis=0) < self._dead_nm[joints]  # False where unknown
        if dead.all():
            return Failure(leg=leg, kind="limp")
        target_range_rad, range_rad = np.ptp(targets_rad, axis=0), np.ptp(measured_rad, axis=0)
        telling = target_range_rad > TELLING_RAD
        still = range_rad < np.maximum(STILL_RAD, STILL_SHARE * target_range_rad)
        if (telling & still).sum() > 1 and not (telling & ~still).any():
            return Failure(leg=leg, kind="locked")
        if dead[worst]:
            return Failure(leg=leg, kind="limp", joint=JOINT_KINDS[worst])
        if still[worst]:
            angle_rad = float(measured_rad[0, worst])
            return Failure(leg=leg, kind="stuck", joint=JOINT_KINDS[worst], angle_rad=angle_rad)
        part = rho > TAKES_PART * rho[worst]
        return Failure(leg=leg, kind="limp", joint=None if part.sum() > 1 else JOINT_KINDS[worst])


def _of_both(legs: tuple[int, ...], rho: float, missing: float) -> FloatArray:
    """A value for rho and one for the load that is missing, of all legs, (2,) + legs."""
    return np.stack([np.full(legs, rho), np.full(legs, missing)])
