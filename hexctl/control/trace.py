"""The frame of a trial: fixed at the start of the walk, origin there, x along the commanded heading."""

from dataclasses import dataclass

import numpy as np

from hexctl.types import FloatArray


@dataclass(frozen=True, slots=True)
class TrialFrame:
    """Where the walk began and which way it was meant to go.

    Attributes:
        origin_world: start of the walk, (3,) in m.
        heading_rad: direction of travel in the world.
        yaw_rad: yaw of the body at the start.
    """

    origin_world: FloatArray
    heading_rad: float
    yaw_rad: float

    def path(self, positions_world: FloatArray) -> FloatArray:
        """Return world positions (T, 3) as (T, 2): progress along the heading, deviation to its left."""
        moved = positions_world - self.origin_world
        cos, sin = np.cos(self.heading_rad), np.sin(self.heading_rad)
        return np.stack(
            [cos * moved[:, 0] + sin * moved[:, 1], cos * moved[:, 1] - sin * moved[:, 0]], axis=-1
        )
