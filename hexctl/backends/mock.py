"""Servos without a robot: they are at once where they are told to go. No physics, no pose."""

from collections import deque

import numpy as np

from hexctl.backends.base import LegServos, check_connected, check_targets
from hexctl.backends.clock import Clock, WallClock
from hexctl.robot.model import Robot
from hexctl.types import JointTargets, RobotState

#: Commands that the mock remembers.
KEPT_COMMANDS = 10_000


class MockServos(LegServos):
    """Echoes its targets, as hobby servos without position feedback do.

    It knows no base pose and no contacts, so a walk on it has neither distance nor deviation. It keeps what
    it was sent in `sent`, newest last, and whether it is limp in `relaxed`.
    """

    def __init__(self, robot: Robot, *, clock: Clock | None = None) -> None:
        self._robot = robot
        self._clock = clock or WallClock()
        self._connected = False
        self._positions_rad = robot.stance_angles_rad.copy()
        self.sent: deque[JointTargets] = deque(maxlen=KEPT_COMMANDS)
        self.relaxed = False

    @property
    def robot(self) -> Robot:
        """Return the robot it stands in for."""
        return self._robot

    @property
    def clock(self) -> Clock:
        """Return its clock, a wall clock unless another was given."""
        return self._clock

    def connect(self) -> None:
        """Start to answer."""
        self._connected = True

    def read(self) -> RobotState:
        """Return the echo of the last targets."""
        check_connected(self._connected, "the mock robot")
        return RobotState(self._positions_rad.copy(), stamp_s=self._clock.now_s, measured=False)

    def write(self, targets: JointTargets) -> JointTargets:
        """Take the targets over at once."""
        check_connected(self._connected, "the mock robot")
        check_targets(targets)
        np.copyto(self._positions_rad, targets.positions_rad)
        self.sent.append(targets)
        self.relaxed = False
        return targets

    def relax(self) -> bool:
        """Go limp until the next targets."""
        check_connected(self._connected, "the mock robot")
        self.relaxed = True
        return True

    def close(self) -> None:
        """Stop answering."""
        self._connected = False
