"""Robots for `hexctl adapt`, named on its command line: they live in a time of their own."""

import math
import os
import signal
from dataclasses import replace

import numpy as np

from hexctl.robot.model import Robot
from hexctl.types import N_JOINTS, RobotState
from tests.cli.kits import Kit
from tests.cli.kits import NoPort as NoPort

#: In the walk of the second trial, where each settles for 1 s, walks for 1 s and stops for 2 s.
IN_TRIAL_2_S = 5.5

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
    """Its joints stay behind by a degree, except one that is not measured."""

    def read(self) -> RobotState:
        state = super().read()
        behind = np.full(N_JOINTS, SAG_RAD)
        behind[-1] = 0.0
        return replace(state, joint_positions_rad=state.joint_positions_rad - behind)


class FallsStanding(Sagging):
    """Falls as soon as it stands up."""

    def read(self) -> RobotState:
        if self.sent:
            self.lean(85.0)
        return super().read()


class InterruptedConnecting(Sagging):
    """Ctrl-C is pressed while it connects."""

    def connect(self) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        super().connect()


class FallsOnce(Kit):
    """Falls in its second trial; it stands again at the next connection."""

    def read(self) -> RobotState:
        if Kit.made[0] is self and self.clock.now_s > IN_TRIAL_2_S:
            self.lean(85.0)
        return super().read()


class EStopped(Kit):
    """Is stopped in its second trial by its own guard, as `hexctl estop` does."""

    def read(self) -> RobotState:
        stopped = "estop" if Kit.made[0] is self and self.clock.now_s > IN_TRIAL_2_S else None
        return replace(super().read(), stopped=stopped)


class Faulty(Kit):
    """Reports a fault of its own in its second trial."""

    def read(self) -> RobotState:
        self.healthy = Kit.made[0] is not self or self.clock.now_s < IN_TRIAL_2_S
        return super().read()


class Unplugged(Kit):
    """Its link breaks in its second trial."""

    def read(self) -> RobotState:
        if Kit.made[0] is self and self.clock.now_s > IN_TRIAL_2_S:
            self.fail_with(OSError(5, "Input/output error"))
        return super().read()
