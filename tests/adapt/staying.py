"""A simulated robot without resets: it stays where it is between trials, sessions and processes."""

import math
from pathlib import Path

import numpy as np

from hexctl.backends.base import LegServos
from hexctl.backends.clock import Clock
from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.world import World
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.types import JointTargets, RobotState

#: Where a robot of the current folder is kept while no program moves it.
PLACE = Path("staying.npz")

#: Ticks after which the place is written down; a program may be killed at any time.
NOTED_TICKS = 25


class StayingSim(LegServos):
    """A twin with leg 5 locked, in a world of its own, that `connect` finds where it was left.

    Attributes:
        farthest_m: how far from its first place the middle of its body has ever been, all robots together.
    """

    world = World()
    failure_of_twin = Failure(leg=5)
    farthest_m = 0.0

    def __init__(self, robot: Robot) -> None:
        self._sim = SimServos(robot, world=self.world, failures=self.failure_of_twin)
        self._ticks = 0
        self._connected = False

    @property
    def robot(self) -> Robot:
        return self._sim.robot

    @property
    def clock(self) -> Clock:
        return self._sim.clock

    def connect(self) -> None:
        self._sim.connect()
        self._connected = True
        if PLACE.exists():
            kept = np.load(PLACE)
            data = self._sim.compiled.physics.data.ptr
            data.qpos[:], data.ctrl[:] = kept["qpos"], kept["ctrl"]

    def read(self) -> RobotState:
        state = self._sim.read()
        assert state.base_position_world is not None
        kind = type(self)
        kind.farthest_m = max(kind.farthest_m, math.hypot(*state.base_position_world[:2].tolist()))
        return state

    def write(self, targets: JointTargets) -> JointTargets:
        sent = self._sim.write(targets)
        self._ticks += 1
        if self._ticks % NOTED_TICKS == 0:
            self._note()
        return sent

    def close(self) -> None:
        if self._connected:
            self._note()
        self._connected = False
        self._sim.close()

    def _note(self) -> None:
        data = self._sim.compiled.physics.data.ptr
        with PLACE.with_suffix(".new").open("wb") as file:
            np.savez(file, qpos=data.qpos, ctrl=data.ctrl)
        PLACE.with_suffix(".new").replace(PLACE)
