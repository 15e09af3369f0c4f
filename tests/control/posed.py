"""A mock robot that knows a pose, which the test gives it."""

import math
from collections.abc import Callable

import numpy as np

from hexctl.backends.base import LegServos, ServosWrapper
from hexctl.backends.mock import MockServos
from hexctl.control.guard import Guard
from hexctl.robot.model import Robot
from hexctl.robot.rotations import quaternion_about
from hexctl.types import FloatArray, JointTargets, RobotState, ServoReadings
from tests.backends.fake_time import FakeTime
from tests.robots import shipped


def readings(**known: FloatArray) -> ServoReadings:
    """Readings of servos just now, of which only some values are known."""
    unknown = dict.fromkeys(("efforts", "currents_a", "voltages_v", "temperatures_c"), np.full(18, np.nan))
    return ServoReadings(**({"ages_s": np.zeros(18)} | unknown | known))


class PosedMock(MockServos):
    """Joints of the mock, a pose of the test's, and time that advances only with the ticks.

    What it says of itself are attributes that a test sets; `joints_rad` None is the mock's echo.
    """

    def __init__(self, robot: Robot | None = None) -> None:
        self.time = FakeTime()
        super().__init__(robot or shipped(), clock=self.time.clock())
        self.position_world: FloatArray | None = np.array([0.0, 0.0, 0.1])
        self.quaternion_world: FloatArray | None = np.array([1.0, 0.0, 0.0, 0.0])
        self.joints_rad: FloatArray | None = None
        self.temperatures_c: FloatArray | None = None
        self.age_s, self.healthy, self.frozen = 0.0, True, False
        self.fault: str | None = None
        self.own_stop: str | None = None
        self._broken: Exception | None = None

    def connect(self) -> None:
        self._use_link()
        super().connect()

    def read(self) -> RobotState:
        self._use_link()
        echo = super().read()
        servos = None if self.temperatures_c is None else readings(temperatures_c=self.temperatures_c)
        return RobotState(
            echo.joint_positions_rad if self.joints_rad is None else self.joints_rad,
            echo.stamp_s,
            measured=True,
            base_position_world=self._noisy(self.position_world),
            base_quaternion_world=self._noisy(self.quaternion_world),
            age_s=self.age_s,
            healthy=self.healthy,
            fault=self.fault,
            stopped=self.own_stop,
            servos=servos,
        )

    def _noisy(self, value: FloatArray | None) -> FloatArray | None:
        """A value with the noise of a sensor, or without it if it is frozen."""
        noise = 0.0 if self.frozen else 1e-12 * (self.clock.index % 1000)
        return None if value is None else value + noise

    def write(self, targets: JointTargets) -> JointTargets:
        self._use_link()
        return super().write(targets)

    def close(self) -> None:
        super().close()
        self._use_link()

    def lean(self, degrees: float) -> None:
        """Let it say that its body leans to the side."""
        self.quaternion_world = quaternion_about((1, 0, 0), math.radians(degrees))

    def spoil(self, part: str) -> None:
        """Let one part of its state say nothing: `joints`, `position`, `quaternion` or `age`."""
        if part == "joints":
            self.joints_rad = self.robot.stance_angles_rad.copy()
            self.joints_rad[11] = math.nan
        elif part == "position":
            self.position_world = np.array([0.0, math.nan, 0.1])
        elif part == "quaternion":
            self.quaternion_world = np.array([math.inf, 0.0, 0.0, 0.0])
        else:
            self.age_s = 0.21

    def fail_with(self, error: Exception) -> None:
        """Let every use of its link raise an error from now on."""
        self._broken = error

    def _use_link(self) -> None:
        if self._broken is not None:
            raise self._broken


#: What sensors show of a state at a time.
Fault = Callable[[RobotState, float], RobotState]


class Faulty(ServosWrapper):
    """Servos whose sensors show something else than what is."""

    def __init__(self, servos: LegServos, fault: Fault) -> None:
        super().__init__(servos)
        self._fault = fault

    def read(self) -> RobotState:
        state = super().read()
        return self._fault(state, state.stamp_s)


class FallsAfter(Guard):
    """Guards servos that some seconds after its making lie on their side."""

    def __init__(self, servos: PosedMock, after_s: float) -> None:
        super().__init__(servos)
        self._posed, self._falls_at_s = servos, servos.time.now_s + after_s

    def read(self) -> RobotState:
        if self._posed.time.now_s > self._falls_at_s:
            self._posed.lean(85.0)
        return super().read()


def connected() -> tuple[Guard, PosedMock]:
    """A guard and the servos behind it, in the first tick."""
    servos = PosedMock()
    guard = Guard(servos)
    guard.connect()
    guard.clock.tick()
    return guard, servos


def send(guard: Guard, wanted: FloatArray) -> FloatArray:
    """The wanted angles as the guard limits them now."""
    return guard.write(JointTargets(wanted, guard.clock.now_s)).joint_positions_rad


def read_for(guard: Guard, duration_s: float) -> None:
    """Read every tick for a duration."""
    for _ in range(round(duration_s / guard.clock.period_s)):
        guard.clock.tick()
        guard.read()
