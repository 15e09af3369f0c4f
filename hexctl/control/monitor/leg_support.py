"""Leg support: how much of its usual load each leg misses, and which joints give no torque.

The load of a leg is the sum of its femur and tibia torques, or without torques its foot contact. It is
weighted by the usual load:

    w = p / p_max,   c = min(1, load / p)       p: usual load at this part of the cycle
    dc' = w^2 (c - c') / (0.15 cycles)          c': share of its load that the leg carries

With both, the missing load is at most 0.4 above the missing contact. A joint is idle while its servo gives no
torque although the joint is off its target, as late as usual; its idle cycles are weighted by w. An intact
joint changes from push to pull in a tick or two.
"""

import math

import numpy as np
from numpy.typing import NDArray

from hexctl.control.monitor.joint_following import JointFollowing
from hexctl.control.monitor.phase_habit import PARTS, PhaseHabit
from hexctl.types import JOINTS_PER_LEG, N_JOINTS, N_LEGS, BoolArray, FloatArray, RobotState

#: Time constant of the carried share, in cycles of full load.
SHARE_CYCLES = 0.15

#: A leg that carries less than this share does not teach the habit.
CALM_SHARE = 0.6

#: Memory of the habit in cycles, and ticks between updates.
MEMORY_CYCLES, LEARNING_TICKS = 3.0, 3

#: Share of a leg's maximum usual load that fades in a cycle, because another gait may have another.
FADES_PER_CYCLE = 0.1

#: Minimum usual load.
LEAST_LOAD = 1e-9

#: Maximum of the missing load minus the missing contact.
BEYOND_CONTACT = 0.4

#: A servo with less than this share of its maximum torque gives none. A leg in the air needs some percent.
NO_TORQUE_SHARE = 0.005

#: Cycles after which the load is known; for one of them phases glide to a new gait.
KNOWN_AFTER_CYCLES = 2.0

#: Ticks without torques and contacts after which earlier evidence is void.
SILENT_TICKS = 10

#: A joint nearer than this to its targets needs no torque.
OFF_RAD = math.radians(2.0)

#: Columns of the loads: of the legs, and of their feet's contacts.
_LEGS, _FEET = slice(0, N_LEGS), slice(N_LEGS, None)


class LegSupport:
    """Share of its usual load that each leg misses, and idle cycles of its joints, tick by tick.

    The first state with torques or contacts decides which of them are used.

    Attributes:
        missing: 0 for a leg that carries as usual, 1 for one that carries nothing, leading shape + (6,).
        idle_cycles: weighted cycles of each joint without torque, leading shape + (18,).
        idle_of_legs: maximum of the joints of each leg, leading shape + (6,).
        known: whether the last state had torques or contacts.
    """

    def __init__(self, shape: tuple[int, ...], cycles: FloatArray) -> None:
        legs, joints = (*shape, N_LEGS), (*shape, N_JOINTS)
        self._shape, self._cycles = shape, np.asarray(cycles)
        self._torques: bool | None = None
        # Arrays of equal shape are the fastest to compute with, so the constants have it too.
        self._off_rad = np.full(joints, OFF_RAD)
        self._per_tick = np.broadcast_to(self._cycles[..., np.newaxis], joints).copy()
        self._legs = np.repeat(np.arange(math.prod(legs)).reshape(legs), JOINTS_PER_LEG, axis=-1)
        self.missing: FloatArray = np.zeros(legs)
        self.idle_cycles: FloatArray = np.zeros(joints)
        self.idle_of_legs: FloatArray = np.zeros(legs)
        self._teaching: BoolArray = np.ones(legs, dtype=bool)
        self.known, self._idle, self._silent_ticks = False, False, 0

    def _begin(self, torques: bool, contacts: bool) -> None:
        """Decide which measurements are used: columns of the loads, leading shape + (6 or 12,)."""
        self._torques, self._feet = torques, torques and contacts
        columns = (*self._shape, N_LEGS * (1 + self._feet))
        legs = np.arange(math.prod(self._teaching.shape)).reshape(self._teaching.shape)
        self._habit, self._ticks = PhaseHabit(columns, np.tile(legs, 1 + self._feet)), 0
        per_tick = np.broadcast_to(self._cycles[..., np.newaxis], columns).copy()
        self._full_rate = np.minimum(1.0, per_tick / SHARE_CYCLES)
        self._least, self._whole = np.full(columns, LEAST_LOAD), np.ones(columns)
        self._calm = np.full(columns, CALM_SHARE)
        self._kept = 1 - FADES_PER_CYCLE * per_tick
        self._passed: FloatArray = LEARNING_TICKS * per_tick
        self._learned_cycles: FloatArray = np.zeros(columns)
        self._see_what_is_known()
        self._teaches = self._columns(self._teaching)
        self._learned, self._share = False, self._passed
        self._carried: FloatArray = np.ones(columns)
        self._most: FloatArray = np.zeros(columns)
        self._loads: FloatArray = np.zeros(columns)
        self._load_of_legs, self._load_of_feet = self._loads[..., _LEGS], self._loads[..., _FEET]

    def update(
        self,
        state: RobotState,
        parts: NDArray[np.int64],
        joints: JointFollowing | None = None,
        size_nm: FloatArray | None = None,
        idle: BoolArray | None = None,
    ) -> None:
        """Take the state of a tick, and parts of the cycle, leading shape + (6,).

        Args:
            joints: how they follow, if measured.
            size_nm: torques without signs, leading shape + (18,), if measured.
            idle: joints without torque, (18,) likewise.
        """
        load = self._load(state, size_nm)
        self.known = load is not None
        self._silent_ticks = 0 if self.known else self._silent_ticks + 1
        if self._silent_ticks == SILENT_TICKS:
            self._forget_evidence(np.array(True))
        if load is None:
            return
        usual = self._habit.at(parts)
        if self._feet and state.foot_contacts is None:
            self._load_of_feet[...] = (usual * self._carried)[..., _FEET]  # nothing new
        some = np.maximum(usual, self._least)
        self._most = np.maximum(self._most * self._kept, some)
        weight = usual / self._most
        share = np.minimum(load / some, self._whole)
        self._carried = self._carried + weight * weight * self._rate * (share - self._carried)
        self.missing = self._whole - self._carried
        if self._feet:
            missing = self.missing
            self.missing = np.minimum(missing[..., _LEGS], missing[..., _FEET] + BEYOND_CONTACT)
        if self._torques and joints is not None and idle is not None:
            self._count_idle(weight, state.joint_positions_rad, joints, idle)
        self._ticks += 1
        if self._ticks % LEARNING_TICKS == 0:
            teaches = (self._carried > self._calm) & self._teaches
            self._habit.learn(self._learns() * teaches * (load - usual))

    def _count_idle(
        self, weight: FloatArray, measured_rad: FloatArray, joints: JointFollowing, idle: BoolArray
    ) -> None:
        if not (self._idle or np.count_nonzero(idle)):
            return
        idle = idle & (joints.off_rad(measured_rad) > self._off_rad)
        before, self._idle = self._idle, bool(np.count_nonzero(idle))
        if not (before or self._idle):
            return
        passed = (weight * self._knows)[..., _LEGS].take(self._legs) * self._per_tick
        self.idle_cycles = (self.idle_cycles + passed) * idle
        self.idle_of_legs = self.idle_cycles.reshape(*self._shape, N_LEGS, JOINTS_PER_LEG).max(axis=-1)

    def forget(self, which: BoolArray, anew: BoolArray, teaching: BoolArray) -> None:
        """Reset robots, leading shape + (1,); `anew` legs learn again, only `teaching` ones learn."""
        self._forget_evidence(which)
        self._teaching = teaching
        if self._torques is None:
            return
        self._learned_cycles = np.where(self._columns(anew), 0.0, self._learned_cycles)
        self._see_what_is_known()
        self._teaches, self._learned = self._columns(teaching), False

    def _see_what_is_known(self) -> None:
        """Update which columns have a known habit: only those can miss their load."""
        self._knows: BoolArray = self._learned_cycles >= KNOWN_AFTER_CYCLES
        self._rate = self._full_rate * self._knows

    def _columns(self, legs: BoolArray) -> BoolArray:
        return np.concatenate([legs, legs], axis=-1) if self._feet else legs

    def _forget_evidence(self, which: BoolArray) -> None:
        """Reset the evidence of some robots, leading shape + (1,), to legs that carry as usual."""
        if self._torques is not None:
            self._carried = np.where(which, 1.0, self._carried)
        self.missing = np.where(which, 0.0, self.missing)
        self.idle_cycles, self.idle_of_legs = self.idle_cycles * ~which, self.idle_of_legs * ~which

    def _learns(self) -> FloatArray:
        """Share of a load that the habit learns: decreases to that of its memory."""
        if not self._learned:
            self._learned_cycles = np.minimum(self._learned_cycles + self._passed, MEMORY_CYCLES)
            passed = PARTS * self._passed
            self._share = passed / (self._learned_cycles + 0.5 + passed)
            self._see_what_is_known()
            self._learned = bool((self._learned_cycles >= MEMORY_CYCLES).all())
        return self._share

    def _load(self, state: RobotState, size_nm: FloatArray | None) -> FloatArray | None:
        """Loads, leading shape + columns, of the kind measured first: torques and contacts do not compare."""
        contacts = state.foot_contacts
        if self._torques is None and not (size_nm is None and contacts is None):
            self._begin(size_nm is not None, contacts is not None)
        if self._torques is False and contacts is not None:
            return contacts.astype(float)
        if not self._torques or size_nm is None:
            return None
        np.add(size_nm[..., 1::JOINTS_PER_LEG], size_nm[..., 2::JOINTS_PER_LEG], out=self._load_of_legs)
        if self._feet and contacts is not None:
            self._load_of_feet[...] = contacts
        return self._loads
