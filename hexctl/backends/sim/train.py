"""What lies between a joint target and the shaft that turns: delay, calibration error, play, a jam."""

import math
from collections import deque
from collections.abc import Sequence
from typing import Self

import numpy as np

from hexctl.backends.sim.physics import Simulation
from hexctl.types import FloatArray


class ServoTrain:
    """Turns the targets of each tick into what the actuators are told; one robot's, or n robots' at once.

    The play is the hysteresis of a loose gear: the shaft rests until the servo has crossed the play, and then
    follows it by half of it behind.

    Attributes:
        plain: whether targets reach the actuators as they are.
    """

    def __init__(self, simulation: Simulation, shaft_rad: FloatArray, late_rad: Sequence[FloatArray]) -> None:
        """Take over where the shafts are and which targets are still on their way, oldest first."""
        self._simulation = simulation
        self._half_play_rad = math.radians(simulation.world.servo_backlash_deg) / 2
        self._shaft_rad = shaft_rad
        self._late_rad = deque(late_rad)
        self.plain = not (
            simulation.jammed.any()
            or simulation.joint_offsets_rad.any()
            or self._late_rad
            or self._half_play_rad
        )

    @classmethod
    def at_rest(cls, simulation: Simulation, stance_rad: FloatArray) -> Self:
        """Return the train of a robot that has stood in its stance for a while."""
        late_rad = [stance_rad] * simulation.world.delay_ticks
        return cls(simulation, stance_rad + simulation.joint_offsets_rad, late_rad)

    def copies(self, n: int) -> "ServoTrain":
        """Return the train of n robots that stand where this one stands; it takes (n, 18)."""
        late_rad = [np.tile(positions_rad, (n, 1)) for positions_rad in self._late_rad]
        return ServoTrain(self._simulation, np.tile(self._shaft_rad, (n, 1)), late_rad)

    def drive(self, positions_rad: FloatArray) -> FloatArray:
        """Return what the actuators get in a tick for its joint targets, (18,) or (n, 18)."""
        if self._late_rad:
            self._late_rad.append(positions_rad.copy())
            positions_rad = self._late_rad.popleft()
        shaft_rad = positions_rad + self._simulation.joint_offsets_rad
        if self._half_play_rad:
            shaft_rad = np.clip(
                self._shaft_rad, shaft_rad - self._half_play_rad, shaft_rad + self._half_play_rad
            )
            self._shaft_rad = shaft_rad
        return np.where(self._simulation.jammed, self._simulation.jammed_at_rad, shaft_rad)
