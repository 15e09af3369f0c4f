"""A pose from outside, such as motion capture, for a robot that does not know its own."""

import time
from dataclasses import replace

from hexctl.backends.base import LegServos
from hexctl.backends.clock import Clock
from hexctl.control.guard import EXPIRY_S
from hexctl.robot.model import Robot
from hexctl.types import FloatArray, JointTargets, RobotState


class PosedServos(LegServos):
    """Servos whose state takes its pose from outside while that is fresh.

    A pose from outside wins over the robot's own; one that stops coming is gone, which the guard sees.
    """

    def __init__(self, servos: LegServos) -> None:
        self._servos = servos
        self.injects_failure, self.failure = servos.injects_failure, servos.failure
        self._pose: tuple[FloatArray, FloatArray] | None = None
        self._pose_at_s = 0.0

    @property
    def robot(self) -> Robot:
        """Return the robot of the servos."""
        return self._servos.robot

    @property
    def clock(self) -> Clock:
        """Return the clock of the servos."""
        return self._servos.clock

    @property
    def link_counts(self) -> dict[str, int]:
        """Return what became of the messages on the way to the servos."""
        return self._servos.link_counts

    def place(self, position_world: FloatArray, quaternion_world: FloatArray, at_s: float) -> None:
        """Take a pose over: position (3,) in m, (w, x, y, z), and when it came on time.monotonic."""
        self._pose, self._pose_at_s = (position_world, quaternion_world), at_s

    def connect(self) -> None:
        """Connect the servos."""
        self._servos.connect()

    def read(self) -> RobotState:
        """Return the state of the servos, with the pose from outside if there ever was one."""
        state = self._servos.read()
        if self._pose is None:
            return state
        fresh = time.monotonic() - self._pose_at_s <= EXPIRY_S
        position, quaternion = self._pose if fresh else (None, None)
        return replace(state, base_position_world=position, base_quaternion_world=quaternion)

    def write(self, targets: JointTargets) -> JointTargets:
        """Write to the servos."""
        return self._servos.write(targets)

    def rest(self) -> None:
        """Tell the servos that no command is due until the next one."""
        self._servos.rest()

    def relax(self) -> bool:
        """Let the servos go limp."""
        return self._servos.relax()

    def close(self) -> None:
        """Close the servos and forget the pose."""
        self._pose = None
        self._servos.close()
