"""Robots for `hexctl adapt`, named on its command line, with simulated time."""

import math
from dataclasses import replace

import numpy as np

from hexctl.robot.model import Robot
from hexctl.types import N_JOINTS, RobotState
from tests.cli.kits import Falls, Interrupting, Kit, PortBreaks, Sick

#: How far the joints of some robots stay behind.
SAG_RAD = math.radians(1.0)


class Blind(Kit):
    """Does not know where it is."""

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self.position_world = self.quaternion_world = None


class Straight(Kit):
    """Its joints are where they are told to be."""


class Sagging(Kit):
    """Its joints stay behind by a degree, except one that is not measured; its trouble is to stand up."""

    def in_trouble(self) -> bool:
        return bool(self.sent)

    def read(self) -> RobotState:
        state = super().read()
        behind = np.full(N_JOINTS, SAG_RAD)
        behind[-1] = 0.0
        return replace(state, joint_positions_rad=state.joint_positions_rad - behind)


class EStopStanding(Sagging):
    """Is stopped by its own guard as soon as it stands up."""

    def read(self) -> RobotState:
        return replace(super().read(), stopped="estop" if self.sent else None)


class FaultStanding(Sagging):
    """Reports a fault as soon as it stands up."""

    def read(self) -> RobotState:
        self.healthy = not self.sent
        return super().read()


class FallsStanding(Sagging, Falls):
    """Falls as soon as it stands up."""


class InterruptedConnecting(Sagging, Interrupting):
    """Ctrl-C is pressed while it connects."""


class TroubleInSecondTrial(Kit):
    """Is in trouble in the walk of its second trial, but not after the next connection.

    Each trial settles for 1 s, walks for 1 s and stops for 2 s.
    """

    trouble_s = 5.5

    def in_trouble(self) -> bool:
        return Kit.made[0] is self and super().in_trouble()


class FallsOnce(TroubleInSecondTrial, Falls):
    """Falls in its second trial."""


class EStopped(TroubleInSecondTrial):
    """Is stopped by its own guard in its second trial, as by `hexctl estop`."""

    def read(self) -> RobotState:
        return replace(super().read(), stopped="estop" if self.in_trouble() else None)


class Faulty(TroubleInSecondTrial, Sick):
    """Reports a fault in its second trial."""


class Unplugged(TroubleInSecondTrial, PortBreaks):
    """Its link breaks in its second trial."""
