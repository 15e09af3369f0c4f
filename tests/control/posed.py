"""A mock robot that knows a pose, which the test gives it."""

import math

import numpy as np

from hexctl.backends.mock import MockServos
from hexctl.robot.messages import FloatArray, RobotState
from hexctl.robot.model import Robot
from tests.backends.fake_time import FakeTime
from tests.robots import shipped


class PosedMock(MockServos):
    """Joints of the mock, a pose of the test's, and time that goes on only with the ticks.

    Attributes:
        time: the time it lives in.
        position_world: where it says it is, or None.
        quaternion_world: how it says it stands, or None.
        healthy: what it says of itself.
    """

    def __init__(self, robot: Robot | None = None) -> None:
        self.time = FakeTime()
        super().__init__(robot or shipped(), clock=self.time.clock())
        self.position_world: FloatArray | None = np.array([0.0, 0.0, 0.1])
        self.quaternion_world: FloatArray | None = np.array([1.0, 0.0, 0.0, 0.0])
        self.healthy = True

    def read(self) -> RobotState:
        """Return the mock's echo with the test's pose."""
        echo = super().read()
        return RobotState(
            echo.joint_positions_rad,
            echo.stamp_s,
            measured=True,
            base_position_world=self.position_world,
            base_quaternion_world=self.quaternion_world,
            healthy=self.healthy,
        )

    def lean(self, degrees: float) -> None:
        """Let it say that its body leans to the side."""
        half = math.radians(degrees) / 2
        self.quaternion_world = np.array([math.cos(half), math.sin(half), 0.0, 0.0])
