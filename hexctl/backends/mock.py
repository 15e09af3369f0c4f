"""Mock servos: every joint is where its last target was. No physics, no pose."""

from collections import deque
from pathlib import Path

import numpy as np

from hexctl.backends.base import OwnServos, check_connected, check_targets
from hexctl.backends.clock import Clock, WallClock
from hexctl.robot.model import Robot
from hexctl.types import JointTargets, RobotState

#: Commands that the mock remembers.
LOGGED_COMMANDS = 10_000


class MockServos(OwnServos):
    """Echoes its targets, as hobby servos without position feedback do; `sent` are the last ones.

    It has neither pose nor contacts: a walk on it has neither distance nor deviation.
    """

    moves_hardware = False

    def __init__(self, robot: Robot | str | Path, *, clock: Clock | None = None) -> None:
        super().__init__(robot, clock or WallClock())
        self._connected = False
        self._positions_rad = self._robot.stance_angles_rad.copy()
        self.sent: deque[JointTargets] = deque(maxlen=LOGGED_COMMANDS)
        self.limp = False

    def connect(self) -> None:
        """Start to answer."""
        self._connected = True

    def read(self) -> RobotState:
        """Echo of the last targets."""
        check_connected(self._connected, "the mock robot")
        return RobotState(self._positions_rad.copy(), stamp_s=self._clock.now_s, measured=False)

    def write(self, targets: JointTargets) -> JointTargets:
        """Take the targets over immediately."""
        check_connected(self._connected, "the mock robot")
        check_targets(targets)
        np.copyto(self._positions_rad, targets.joint_positions_rad)
        self.sent.append(targets)
        self.limp = False
        return targets

    def disable_torque(self) -> bool:
        """Go limp until the next targets."""
        check_connected(self._connected, "the mock robot")
        self.limp = True
        return True

    def close(self) -> None:
        """Stop answering."""
        self._connected = False
