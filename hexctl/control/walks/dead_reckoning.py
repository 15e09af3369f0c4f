"""Dead reckoning: how far a robot that knows its yaw has drifted off its line, by the feet on the floor."""

import numpy as np

from hexctl.ik.leg_odometry import stance_motions
from hexctl.robot.model import Robot
from hexctl.types import N_JOINTS, N_LEGS, FloatArray, RobotState

#: Ticks evaluated at once, which makes a tick cheap.
BLOCK_TICKS = 50


class DeadReckoning:
    """Deviation from a line, positive to the left, leading shape in m; for one robot or a batch.

    The body moves against its standing feet, whose places follow from measured joint angles. It needs foot
    contacts: the load of the joints tells stance from swing too roughly.
    """

    def __init__(self, robot: Robot, shape: tuple[int, ...], period_s: float) -> None:
        self._robot, self._period_s = robot, period_s
        self._joints_rad = np.empty((BLOCK_TICKS + 1, *shape, N_JOINTS))
        self._contacts = np.empty((BLOCK_TICKS + 1, *shape, N_LEGS), dtype=bool)
        self._off_rad = np.empty((BLOCK_TICKS + 1, *shape))
        self._zero: FloatArray = np.zeros(shape)[()]
        self._unknown: FloatArray = np.full(shape, np.nan)[()]
        self.restart()

    def restart(self) -> None:
        """Begin on the line."""
        self._deviation_m, self._tick = self._zero, 0

    def update(self, state: RobotState, off_rad: FloatArray) -> FloatArray:
        """Take the state of the next tick: the deviation, or NaN if angles or contacts are not measured.

        The yaw relative to the line is `off_rad`, leading shape.
        """
        if state.foot_contacts is None or not state.measured:
            self._tick = 0
            return self._unknown
        tick = self._tick
        self._joints_rad[tick], self._contacts[tick] = state.joint_positions_rad, state.foot_contacts
        self._off_rad[tick] = off_rad
        self._tick = tick + 1
        if tick == BLOCK_TICKS:
            self._advance()
        return self._deviation_m

    def _advance(self) -> None:
        """Add the motion of a block, whose last tick begins the next one."""
        shift = stance_motions(self._robot, self._joints_rad, self._contacts, self._period_s)
        left_m = (shift * np.exp(1j * self._off_rad[:-1])).imag
        left_m = np.where(np.isfinite(left_m), left_m, 0.0)
        self._deviation_m = self._deviation_m + np.cumsum(left_m, axis=0)[-1]
        for block in (self._joints_rad, self._contacts, self._off_rad):
            block[0] = block[-1]
        self._tick = 1
