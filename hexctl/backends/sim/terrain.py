"""The floor of a world: even or rough, level or sloping."""

import math
from dataclasses import dataclass

import numpy as np

from hexctl.backends.sim.world import World
from hexctl.types import ArrayFields, FloatArray

#: Half side of the rough patch; the floor beyond it is even.
ROUGH_HALF_SIZE_M = 8.0
ROUGH_CELLS = 400

#: Width of the edge in which the bumps end.
EDGE_M = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Floor(ArrayFields):
    """Geometry of a floor, for the physics and for rendering.

    Attributes:
        quaternion_world: orientation of the floor's plane (w, x, y, z).
        normal_world: unit vector out of the floor.
        heights_m: (rows along y, columns along x) above the plane, or None for an even floor.
    """

    quaternion_world: FloatArray
    normal_world: FloatArray
    heights_m: FloatArray | None

    def highest_near_origin_m(self, radius_m: float) -> float:
        """Maximum height within a radius of the origin."""
        if self.heights_m is None:
            return 0.0
        axis = np.linspace(-ROUGH_HALF_SIZE_M, ROUGH_HALF_SIZE_M, ROUGH_CELLS)
        near = np.hypot(axis[:, np.newaxis], axis) <= radius_m
        return float(self.heights_m[near].max())


def make_floor(world: World, seed: int) -> Floor:
    """The floor of a world; its bumps are drawn with the seed."""
    slope, uphill = math.radians(world.slope_deg), math.radians(world.slope_direction_deg)
    # Turning x toward z is a negative turn about y, so uphill along x turns about -y.
    axis = np.array([math.sin(uphill), -math.cos(uphill), 0.0])
    quaternion = np.concatenate([[math.cos(slope / 2)], math.sin(slope / 2) * axis])
    normal = np.array(
        [-math.sin(slope) * math.cos(uphill), -math.sin(slope) * math.sin(uphill), math.cos(slope)]
    )
    heights = _bumps(world, seed) if world.roughness_m else None
    return Floor(quaternion, normal, heights)


def _bumps(world: World, seed: int) -> FloatArray:
    """Gaussian-correlated noise of the standard deviation of the world, smoothed in the Fourier domain."""
    white = np.random.default_rng(seed).standard_normal((ROUGH_CELLS, ROUGH_CELLS))
    cell_m = 2 * ROUGH_HALF_SIZE_M / ROUGH_CELLS
    frequency = np.fft.fftfreq(ROUGH_CELLS, d=cell_m)
    squared = frequency[:, np.newaxis] ** 2 + frequency**2
    smoothing = np.exp(-0.5 * squared * (math.pi * world.roughness_length_m / 2) ** 2)
    smooth: FloatArray = np.fft.ifft2(np.fft.fft2(white) * smoothing).real
    smooth *= world.roughness_m / smooth.std()
    # Toward the edge the floor sinks to its lowest point, where the even floor beyond begins.
    lowest = smooth.min()
    return np.asarray(lowest + _inside() * (smooth - lowest))


def _inside() -> FloatArray:
    """1 inside the patch, falling to 0 over its edge, (cells, cells)."""
    axis = np.linspace(-ROUGH_HALF_SIZE_M, ROUGH_HALF_SIZE_M, ROUGH_CELLS)
    share = np.clip((ROUGH_HALF_SIZE_M - np.abs(axis)) / EDGE_M, 0.0, 1.0)
    return np.asarray(np.minimum(share[:, np.newaxis], share))
