"""LegServos of one's own, as modules named on the command line: each has a trouble of its own."""

import os
import signal

from hexctl.robot.model import Robot
from hexctl.types import JointTargets, RobotState
from tests.control.posed import PosedMock


class Kit(PosedMock):
    """A robot in good health, with a clock that does not wait.

    Attributes:
        made: all kits made so far, newest last.
        closed: how often it was closed.
        trouble_s: when the trouble of a kit begins.
    """

    made: "list[Kit]" = []  # noqa: RUF012  shared on purpose: the command line makes the kits
    trouble_s = 2.0

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self.closed = 0
        Kit.made.append(self)

    def close(self) -> None:
        self.closed += 1
        super().close()

    def in_trouble(self) -> bool:
        """Whether its trouble has begun."""
        return self.clock.now_s >= self.trouble_s


class Sick(Kit):
    """Reports a fault of its own."""

    def read(self) -> RobotState:
        self.healthy = not self.in_trouble()
        return super().read()


class Falls(Kit):
    """Falls."""

    def read(self) -> RobotState:
        if self.in_trouble():
            self.lean(85.0)
        return super().read()


class Lost(Kit):
    """Loses its pose."""

    def read(self) -> RobotState:
        if self.in_trouble():
            self.position_world = self.quaternion_world = None
        return super().read()


class PortBreaks(Kit):
    """A serial port is pulled out."""

    def write(self, targets: JointTargets) -> JointTargets:
        if self.in_trouble():
            self.fail_with(OSError(5, "Input/output error"))
        return super().write(targets)


class BreaksAtOnce(PortBreaks):
    """It is pulled out before the first command."""

    trouble_s = 0.0


class Interrupting(Kit):
    """Ctrl-C comes while it connects."""

    def connect(self) -> None:
        super().connect()
        os.kill(os.getpid(), signal.SIGINT)


class NoPipe(Kit):
    """Cannot be connected: the program at the other end is dead."""

    def connect(self) -> None:
        raise BrokenPipeError(32, "Broken pipe")


class NoPort(Kit):
    """Cannot be connected: there is no such port."""

    def connect(self) -> None:
        raise FileNotFoundError(2, "No such file or directory", "/dev/ttyUSB7")
