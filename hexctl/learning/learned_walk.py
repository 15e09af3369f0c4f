"""A walk whose feet a policy moves: the same class while it learns and while it walks.

The policy modulates a trajectory generator, after A. Iscen et al., "Policies Modulating Trajectory
Generators", CoRL 2018. The generator is the steered walk of the trial; the policy adds offsets to its feet.
"""

from collections.abc import Callable

import numpy as np

from hexctl.control.preparation import WalkStart
from hexctl.control.walks.steered_walk import SteeredWalk
from hexctl.robot.rotations import components
from hexctl.types import N_JOINTS, N_LEGS, FloatArray, RobotState

#: Maximum offset of a foot along each axis of the body, as a share of the robot's size.
OFFSET_SHARE = 0.04

#: Time constants with which offsets follow actions, and with which measurements are averaged.
ACTION_S, AVERAGE_S = 0.1, 0.5

#: Following error and lean that count as 1 in an observation, and its bound.
ERROR_RAD, LEAN, OBSERVED = 0.2, 0.2, 5.0

#: Numbers of an action: an offset of each foot forward, left and up, -1 to 1.
ACTION_SIZE = 3 * N_LEGS

#: Numbers of an observation: following errors now and on average, contacts now and on average, offsets of the
#: feet, sine and cosine of each leg's phase, commanded velocity, and the vertical's part forward and left.
OBSERVATION_SIZE = 2 * N_JOINTS + 2 * N_LEGS + ACTION_SIZE + 2 * N_LEGS + 3 + 2

#: Action, leading shape + (18,), for an observation, leading shape + (OBSERVATION_SIZE,).
Policy = Callable[[FloatArray], FloatArray]


class LearnedWalk(SteeredWalk):
    """Walks along the line of the trial, with offsets of the feet by a policy.

    Args:
        policy: None if `observe` and `act` are called instead of `targets_rad`.
    """

    def __init__(self, start: WalkStart, policy: Policy | None = None, *, hold: str = "line") -> None:
        super().__init__(start, hold=hold)
        self._policy = policy
        self._follows, self._averages = (
            1 - np.exp(-start.period_s / time_s) for time_s in (ACTION_S, AVERAGE_S)
        )
        shape = start.batch_shape
        self._offset_m = OFFSET_SHARE * start.robot.size_m
        self._full_m_s = self._pattern.amplitude_m / self._per_second
        self._full_turn_rad_s = self._full_m_s / start.robot.stance_radius_m
        self._asked_rad: FloatArray | None = None
        self._offsets: FloatArray = np.zeros((*shape, ACTION_SIZE))
        self._mean_error: FloatArray = np.zeros((*shape, N_JOINTS))
        self._mean_contact: FloatArray = np.ones((*shape, N_LEGS))
        self._lean: FloatArray = np.zeros((*shape, 2))

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        """Joint angles at this step, leading shape + (18,)."""
        assert self._policy is not None  # noqa: S101  else `act` is called
        return self.act(step, state, self._policy(self.observe(state)))

    def observe(self, state: RobotState) -> FloatArray:
        """Observation of a state, leading shape + (OBSERVATION_SIZE,).

        Unknown contacts count as floor, unknown angles as the commanded ones.
        """
        asked_rad = state.joint_positions_rad if self._asked_rad is None else self._asked_rad
        error = (state.joint_positions_rad - asked_rad) / ERROR_RAD
        error = np.where(np.isnan(error), 0.0, error)
        contact = state.foot_contacts
        touching = np.ones_like(self._mean_contact) if contact is None else contact.astype(float)
        self._mean_error = self._mean_error + self._averages * (error - self._mean_error)
        self._mean_contact = self._mean_contact + self._averages * (touching - self._mean_contact)
        if state.base_quaternion_world is not None:
            w, x, y, z = components(state.base_quaternion_world)
            lean = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x)], axis=-1) / LEAN
            self._lean = np.where(np.isnan(lean), self._lean, lean)
        angles = 2 * np.pi * self.leg_phases
        velocity = self.velocity_body / np.stack(
            [self._full_m_s, self._full_m_s, self._full_turn_rad_s], axis=-1
        )
        parts = (error, self._mean_error, touching, self._mean_contact, self._offsets)
        values = np.concatenate([*parts, np.sin(angles), np.cos(angles), velocity, self._lean], axis=-1)
        return np.asarray(np.clip(values, -OBSERVED, OBSERVED))

    def act(self, step: int, state: RobotState, action: FloatArray) -> FloatArray:
        """Joint angles at this step under an action, leading shape + (18,) each."""
        wanted = np.clip(action, -1.0, 1.0)
        self._offsets = self._offsets + self._follows * (wanted - self._offsets)
        self.foot_offsets_m = self._offset_m * self._offsets.reshape(*self._offsets.shape[:-1], N_LEGS, 3)
        self._asked_rad = super().targets_rad(step, state)
        return self._asked_rad
