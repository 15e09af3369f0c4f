"""Leg support: how much of the load that a leg usually carries is missing.

With efforts the load of a leg is the sum of the torques of its femur and tibia, without them whether its foot
touches the floor. Where in its cycle it usually carries much, it counts much:

    w = (p / p_max)^2,   c = min(1, load / p)      p: usual load at this part of the cycle
    dc' = w (c - c') / (0.15 cycles)               c': share of its load that the leg carries
"""

import numpy as np

from hexctl.control.monitor.phase_habit import PARTS, PhaseHabit
from hexctl.types import JOINTS_PER_LEG, N_LEGS, BoolArray, FloatArray, RobotState

#: Time constant of the share that a leg carries, in cycles of full load.
SHARE_CYCLES = 0.15

#: A leg that carries less than this share no longer teaches what is usual.
CALM_SHARE = 0.6

#: Cycles that the habit looks back.
MEMORY_CYCLES = 3.0


class LegSupport:
    """Share of its usual load that each leg misses, tick by tick.

    Args:
        shape: leading shape.

    Attributes:
        missing: 0 for a leg that carries as usual, 1 for one that carries nothing, leading shape + (6,).
        known: whether the last state told anything of it.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self._shape = shape
        self._habit = PhaseHabit((*shape, N_LEGS))
        self._learned_cycles: FloatArray = np.zeros((*shape, 1))
        self._carried: FloatArray = np.ones((*shape, N_LEGS))
        self._most: FloatArray = np.zeros((*shape, N_LEGS))
        self.missing: FloatArray = np.zeros((*shape, N_LEGS))
        self.known = False

    def update(self, state: RobotState, phases: FloatArray, cycles: FloatArray) -> None:
        """Take the state of a tick.

        Args:
            state: as measured.
            phases: normalised times of the legs, leading shape + (6,).
            cycles: that one tick takes, leading shape.
        """
        load = self._load(state)
        self.known = load is not None
        if load is None:
            return
        per_cycle = np.asarray(cycles)[..., np.newaxis]
        usual, _ = self._habit.at(np.minimum((phases * PARTS).astype(int), PARTS - 1))
        # A leg's largest usual load fades slowly, so that that of another gait does not stay.
        self._most = np.maximum(self._most * (1 - 0.1 * per_cycle), usual)
        weight = np.minimum(1.0, usual / np.maximum(self._most, 1e-9)) ** 2
        share = np.minimum(1.0, load / np.maximum(usual, 1e-9))
        self._carried += np.minimum(1.0, weight * per_cycle / SHARE_CYCLES) * (share - self._carried)
        self.missing = 1 - self._carried
        self._learned_cycles = np.minimum(self._learned_cycles + per_cycle, MEMORY_CYCLES)
        rate = PARTS * per_cycle / (self._learned_cycles + 0.5 + PARTS * per_cycle)
        off = rate * (self._carried > CALM_SHARE) * (load - usual)
        self._habit.learn(off, np.zeros_like(off))

    def forget(self, which: BoolArray) -> None:
        """Take the legs of some robots, leading shape + (1,), for legs that carry as usual."""
        self._carried = np.where(which, 1.0, self._carried)

    def _load(self, state: RobotState) -> FloatArray | None:
        if state.joint_torques_nm is not None:
            legs = state.joint_torques_nm.reshape(*self._shape, N_LEGS, JOINTS_PER_LEG)
            return np.asarray(np.abs(legs[..., 1:]).sum(axis=-1))
        return None if state.foot_contacts is None else state.foot_contacts.astype(float)
