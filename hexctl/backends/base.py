"""The abstract leg-servo interface: the only way to a robot, simulated or real."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import TracebackType
from typing import TYPE_CHECKING, Self

import numpy as np

from hexctl.backends.clock import Clock
from hexctl.errors import CommandRefusedError, RobotFaultError
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.types import N_JOINTS, JointTargets, RobotState

if TYPE_CHECKING:
    from hexctl.wire.description import RobotIdentity


class LegServos(ABC):
    """Eighteen leg servos with a clock.

    `robot` and `clock` can be read before `connect`. One tick is: `clock.tick()`, `read()`, `write()`.
    `hexctl.testing.LegServosConformance` states what every implementation must do, as tests.
    """

    #: True for a simulation, which knows the failure that it injects; a real robot does not.
    injects_failure: bool = False

    #: The leg that a simulation breaks, or None.
    failure: Failure | None = None

    #: Once connected to a simulation over a link: what it says of itself, `world` and `failure`; else None.
    simulated: Mapping[str, str] | None = None

    #: Once connected to a robot over a link: which robot answered and who started it; else None.
    identity: "RobotIdentity | None" = None

    @property
    @abstractmethod
    def robot(self) -> Robot:
        """Return the description of the robot at the other end."""

    @property
    @abstractmethod
    def clock(self) -> Clock:
        """Return the clock that says when the next tick is due."""

    @property
    def link_counts(self) -> dict[str, int]:
        """Return what became of messages on the way to a robot so far, by name; empty without such a way."""
        return {}

    @abstractmethod
    def connect(self) -> None:
        """Reach the robot; a second call changes nothing.

        Raises RobotFaultError when it cannot be reached.
        """

    @abstractmethod
    def read(self) -> RobotState:
        """Return the newest state; never waits for one.

        Raises RobotFaultError when not connected or when the robot has gone.
        """

    @abstractmethod
    def write(self, targets: JointTargets) -> JointTargets:
        """Send targets and return what was really sent.

        Raises CommandRefusedError for targets of another shape or with a value that is not finite, and
        RobotFaultError when not connected.
        """

    def rest(self) -> None:  # noqa: B027  most servos have nobody to tell
        """Say that no command is due until the next one, to a robot that would take silence for a failure."""

    def relax(self) -> bool:
        """Let the joints go limp until the next `write`; return False where the servos cannot."""
        return False

    @abstractmethod
    def close(self) -> None:
        """Let go of the robot and everything opened; a second call changes nothing."""

    def __enter__(self) -> Self:
        try:
            self.connect()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def check_targets(targets: JointTargets) -> None:
    """Raise CommandRefusedError unless the targets are 18 finite angles."""
    positions = targets.positions_rad
    if positions.shape != (N_JOINTS,):
        raise CommandRefusedError(f"targets: got shape {positions.shape}; allowed: ({N_JOINTS},)")
    # A sum is finite only if every term is, and is cheaper than asking each one.
    if not math.isfinite(np.add.reduce(positions)):
        raise CommandRefusedError(f"targets: got {positions.tolist()}; allowed: finite angles in rad")


def check_connected(connected: bool, who: str) -> None:
    """Raise RobotFaultError unless connected."""
    if not connected:
        raise RobotFaultError(f"{who} is not connected; call connect() first, or use it in a with statement")
