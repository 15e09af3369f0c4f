"""The floor of a world: even, or rough, of blocks, with pits or ramps; level or sloping."""

import math
from dataclasses import dataclass

import numpy as np

from hexctl.backends.sim.world import World
from hexctl.robot.rotations import quaternion_about
from hexctl.types import ArrayFields, FloatArray

#: Half side of the uneven patch; the floor beyond it is even.
ROUGH_HALF_SIZE_M = 8.0
ROUGH_CELLS = 400

#: Blocks and pits need steep sides: these are one cell wide.
BLOCK_CELLS = 1600

#: Width of the edge in which the patch ends.
EDGE_M = 1.0

#: Half side of the even place in the middle of blocks, pits and ramps, where the robot starts.
START_M = 0.4

#: Share of the blocks that are pits.
PIT_SHARE = 0.25


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
        axis = _axis(len(self.heights_m))
        near = np.hypot(axis[:, np.newaxis], axis) <= radius_m
        return float(self.heights_m[near].max())


def make_floor(world: World, seed: int) -> Floor:
    """The floor of a world; bumps, blocks and pits are drawn with the seed."""
    slope, uphill = math.radians(world.slope_deg), math.radians(world.slope_direction_deg)
    # Turning x toward z is a negative turn about y, so uphill along x turns about -y.
    quaternion = quaternion_about((math.sin(uphill), -math.cos(uphill), 0.0), slope)
    normal = np.array(
        [-math.sin(slope) * math.cos(uphill), -math.sin(slope) * math.sin(uphill), math.cos(slope)]
    )
    return Floor(quaternion, normal, None if world.even_floor else _heights(world, seed))


def _heights(world: World, seed: int) -> FloatArray:
    """Heights of an uneven floor, (cells, cells); toward the edge it sinks to its lowest point.

    There the even floor beyond begins.
    """
    cells = BLOCK_CELLS if world.step_height_m or world.pit_depth_m else ROUGH_CELLS
    heights: FloatArray = np.zeros((cells, cells))
    if world.step_height_m or world.pit_depth_m:
        heights += _blocks(world, seed, cells)
    if world.ramp_deg:
        heights += _ramps(world, cells)
    if world.roughness_m:
        heights += _bumps(world, seed, cells)
    lowest = heights.min()
    return np.asarray(lowest + _inside(cells) * (heights - lowest))


def _bumps(world: World, seed: int, cells: int) -> FloatArray:
    """Gaussian-correlated noise of the standard deviation of the world, smoothed in the Fourier domain."""
    white = np.random.default_rng(seed).standard_normal((cells, cells))
    frequency = np.fft.fftfreq(cells, d=2 * ROUGH_HALF_SIZE_M / cells)
    squared = frequency[:, np.newaxis] ** 2 + frequency**2
    smoothing = np.exp(-0.5 * squared * (math.pi * world.roughness_length_m / 2) ** 2)
    smooth: FloatArray = np.fft.ifft2(np.fft.fft2(white) * smoothing).real
    smooth *= world.roughness_m / smooth.std()
    return smooth


def _blocks(world: World, seed: int, cells: int) -> FloatArray:
    """Heights of square blocks, half of the step height up or down, of which some are sunken."""
    axis = _axis(cells)
    number = np.floor((axis + START_M) / world.block_m).astype(int)
    number -= number.min()
    # A separate stream: bumps have 0, joint offsets 1, noise 2, commands 3, unknown failures 4, poses 5.
    stream = np.random.default_rng([seed, 6])
    shares = stream.uniform(-0.5, 0.5, (number[-1] + 1,) * 2)
    pits = stream.random(shares.shape) < PIT_SHARE
    blocks = world.step_height_m * shares - world.pit_depth_m * pits
    heights = blocks[np.ix_(number, number)]
    heights[np.ix_(abs(axis) <= START_M, abs(axis) <= START_M)] = 0.0
    return np.asarray(heights)


def _ramps(world: World, cells: int) -> FloatArray:
    """Ramps that begin at the even place and go up and down in turn, to both sides."""
    beyond = np.maximum(np.abs(_axis(cells)) - START_M, 0.0) / world.ramp_length_m
    risen = 1 - np.abs(beyond % 2 - 1)
    rise_m = math.tan(math.radians(world.ramp_deg)) * world.ramp_length_m
    return np.broadcast_to(rise_m * risen, (cells, cells))


def _inside(cells: int) -> FloatArray:
    """1 inside the patch, falling to 0 over its edge, (cells, cells)."""
    share = np.clip((ROUGH_HALF_SIZE_M - np.abs(_axis(cells))) / EDGE_M, 0.0, 1.0)
    return np.asarray(np.minimum(share[:, np.newaxis], share))


def _axis(cells: int) -> FloatArray:
    """Coordinates of the cells in the floor's plane, (cells,)."""
    return np.linspace(-ROUGH_HALF_SIZE_M, ROUGH_HALF_SIZE_M, cells)
