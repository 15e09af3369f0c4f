"""Leg support: how much of the load that a leg usually carries is missing.

With efforts the load of a leg is the sum of the torques of its femur and tibia, without them whether its foot
touches the floor. Where in its cycle it usually carries much, it counts much:

    w = (p / p_max)^2,   c = min(1, load / p)      p: usual load at this part of the cycle
    dc' = w (c - c') / (0.15 cycles)               c': share of its load that the leg carries
"""

import numpy as np
from numpy.typing import NDArray

from hexctl.control.monitor.phase_habit import PARTS, PhaseHabit
from hexctl.types import JOINTS_PER_LEG, N_LEGS, BoolArray, FloatArray, RobotState

#: Time constant of the share that a leg carries, in cycles of full load.
SHARE_CYCLES = 0.15

#: A leg that carries less than this share no longer teaches what is usual.
CALM_SHARE = 0.6

#: Cycles that the habit looks back, and ticks after which it learns.
MEMORY_CYCLES, LEARNING_TICKS = 3.0, 2

#: Share of a leg's largest usual load that fades in a cycle, so that that of another gait does not stay.
FADES_PER_CYCLE = 0.1

#: A usual load below this is none.
LEAST_LOAD = 1e-9


class LegSupport:
    """Share of its usual load that each leg misses, tick by tick.

    Args:
        shape: leading shape.
        cycles: that one tick takes, leading shape.

    Attributes:
        missing: 0 for a leg that carries as usual, 1 for one that carries nothing, leading shape + (6,).
        known: whether the last state told anything of it.
    """

    def __init__(self, shape: tuple[int, ...], cycles: FloatArray) -> None:
        legs = (*shape, N_LEGS)
        self._habit, self._ticks = PhaseHabit(legs), 0
        # Arrays of one shape are the fastest to calculate with, so the constants have it too.
        per_tick = np.repeat(np.asarray(cycles)[..., np.newaxis], N_LEGS, axis=-1)
        self._rate = np.minimum(1.0, per_tick / SHARE_CYCLES)
        self._least, self._whole = np.full(legs, LEAST_LOAD), np.ones(legs)
        self._calm = np.full(legs, CALM_SHARE)
        self._kept = 1 - FADES_PER_CYCLE * per_tick
        self._passed: FloatArray = LEARNING_TICKS * per_tick
        self._learned_cycles: FloatArray = np.zeros(legs)
        self._learned, self._share = False, self._rate
        self._carried: FloatArray = np.ones(legs)
        self._most: FloatArray = np.zeros(legs)
        self.missing: FloatArray = np.zeros(legs)
        self.known = False
        self._by_torque: bool | None = None

    def update(self, state: RobotState, parts: NDArray[np.int64]) -> None:
        """Take the state of a tick.

        Args:
            state: as measured.
            parts: of the cycle that the legs are in, leading shape + (6,).
        """
        load = self._load(state)
        self.known = load is not None
        if load is None:
            return
        usual = self._habit.at(parts)
        some = np.maximum(usual, self._least)
        self._most = np.maximum(self._most * self._kept, some)
        weight = usual / self._most
        share = np.minimum(load / some, self._whole)
        self._carried = self._carried + weight * weight * self._rate * (share - self._carried)
        self.missing = self._whole - self._carried
        self._ticks += 1
        if self._ticks % LEARNING_TICKS == 0:
            self._habit.learn(self._learns() * (self._carried > self._calm) * (load - usual))

    def forget(self, which: BoolArray) -> None:
        """Take the legs of some robots, leading shape + (1,), for legs that carry as usual."""
        self._carried = np.where(which, 1.0, self._carried)

    def _learns(self) -> FloatArray:
        """Share of a load that the habit learns: the less, the more it has seen, down to its memory's."""
        if not self._learned:
            self._learned_cycles = np.minimum(self._learned_cycles + self._passed, MEMORY_CYCLES)
            passed = PARTS * self._passed
            self._share = passed / (self._learned_cycles + 0.5 + passed)
            self._learned = bool((self._learned_cycles >= MEMORY_CYCLES).all())
        return self._share

    def _load(self, state: RobotState) -> FloatArray | None:
        """Load of each leg, from what told it first: torques or contacts, whose numbers do not compare."""
        if self._by_torque is None:
            self._by_torque = state.joint_torques_nm is not None or (
                None if state.foot_contacts is None else False
            )
        if self._by_torque and state.joint_torques_nm is not None:
            size_nm = np.abs(state.joint_torques_nm)
            return size_nm[..., 1::JOINTS_PER_LEG] + size_nm[..., 2::JOINTS_PER_LEG]
        if self._by_torque is False and state.foot_contacts is not None:
            return state.foot_contacts.astype(float)
        return None
