"""Measurement noise of the simulated sensors, drawn once per tick so that every reader sees the same."""

import math

import numpy as np

from hexctl.backends.sim.world import SensorNoise
from hexctl.types import N_JOINTS, FloatArray

N_DRAWS = N_JOINTS + 4


class Noise:
    """A seeded stream of measurement errors: 18 joints, 3 of position, 1 of yaw."""

    def __init__(self, sigma: SensorNoise, seed: int, trial: int = 0) -> None:
        # A stream of its own beside those of the bumps and of the joint offsets.
        self._stream = np.random.default_rng([seed, 2, trial])
        self._scale = np.array(
            [math.radians(sigma.joint_deg)] * N_JOINTS
            + [sigma.position_m] * 3
            + [math.radians(sigma.yaw_deg)]
        )
        self.silent = not self._scale.any()
        self._errors = np.zeros(N_DRAWS)

    def draw(self) -> None:
        """Draw the errors of the next tick."""
        if not self.silent:
            self._errors = self._stream.standard_normal(N_DRAWS) * self._scale

    @property
    def joints_rad(self) -> FloatArray:
        """Return the errors of the joint angles, (18,)."""
        return self._errors[:N_JOINTS]

    @property
    def position_m(self) -> FloatArray:
        """Return the error of the base position, (3,)."""
        return self._errors[N_JOINTS:-1]

    def turned(self, quaternion: FloatArray) -> FloatArray:
        """Return orientations (..., 4) turned about the vertical by the yaw error."""
        cos, sin = math.cos(self._errors[-1] / 2), math.sin(self._errors[-1] / 2)
        w, x, y, z = (quaternion[..., index] for index in range(4))
        return np.stack([cos * w - sin * z, cos * x - sin * y, cos * y + sin * x, cos * z + sin * w], axis=-1)
