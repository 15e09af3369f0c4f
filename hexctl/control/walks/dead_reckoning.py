"""Dead reckoning: how far a robot that knows its yaw has drifted off its line, by the feet on the floor."""

import numpy as np

from hexctl.ik.leg_odometry import stance_motions
from hexctl.robot.model import Robot
from hexctl.types import N_JOINTS, N_LEGS, FloatArray, RobotState

#: Ticks evaluated at once, which makes a tick cheap.
BLOCK_TICKS = 50


class DeadReckoning:
    """Deviation from a line, positive to the left, leading shape in m; for one robot or a batch.

    The body moves against its standing feet, whose places follow from measured joint angles and yaw. It needs
    foot contacts: the load of the joints tells stance from swing too roughly.
    """

    def __init__(self, robot: Robot, shape: tuple[int, ...], period_s: float) -> None:
        self._robot, self._period_s = robot, period_s
        # The yaw is the mean of three ticks: one more at each end.
        ticks = BLOCK_TICKS + 3
        self._joints_rad = np.empty((ticks, *shape, N_JOINTS))
        self._contacts = np.empty((ticks, *shape, N_LEGS), dtype=bool)
        self._yaw_rad = np.empty((ticks, *shape))
        self._zero: FloatArray = np.zeros(shape)[()]
        self._unknown: FloatArray = np.full(shape, np.nan)[()]
        self.restart()

    def restart(self) -> None:
        """Begin on the line."""
        self._deviation_m, self._ticks = self._zero, 0

    def update(self, state: RobotState, yaw_rad: FloatArray) -> FloatArray:
        """Take the state of the next tick: the deviation, or NaN if angles or contacts are not measured.

        The yaw counts from the line, leading shape, unwrapped.
        """
        if state.foot_contacts is None or not state.measured:
            self._ticks = 0
            return self._unknown
        tick = self._ticks
        self._joints_rad[tick], self._contacts[tick] = state.joint_positions_rad, state.foot_contacts
        self._yaw_rad[tick] = yaw_rad
        self._ticks = tick + 1
        if self._ticks == len(self._yaw_rad):
            self._advance()
        return self._deviation_m

    def _advance(self) -> None:
        """Add the motion of a block; its end is the beginning of the next one."""
        yaw_rad = self._yaw_rad
        smooth_rad = (yaw_rad[:-2] + yaw_rad[1:-1] + yaw_rad[2:]) / 3
        joints_rad, contacts = self._joints_rad[1:-1], self._contacts[1:-1]
        left_m = stance_motions(self._robot, joints_rad, contacts, smooth_rad, self._period_s).imag
        # Contacts that do not change are dead, or the robot stands.
        stepping = (contacts[1:] != contacts[:-1]).any(axis=(0, -1))
        left_m = np.where(np.isfinite(left_m) & stepping, left_m, 0.0)
        # A running sum, whose order is that of a single robot in a batch as well.
        self._deviation_m = self._deviation_m + np.cumsum(left_m, axis=0)[-1]
        for block in (self._joints_rad, self._contacts, yaw_rad):
            block[:3] = block[-3:]  # the yaw is a mean of three ticks
        self._ticks = 3
