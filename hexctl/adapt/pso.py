"""`pso`: particle swarm optimization with one global best."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from hexctl.adapt.population import POPULATION, Population, PopulationOptimizer
from hexctl.types import BoolArray, FloatArray


class ParticleSwarm(Population):
    """A swarm that follows its global best.

        v ← ω v + c1 r1 (p - x) + c2 r2 (g - x),   x ← x + v

    p is the particle's best position so far, g the best of all; r1 and r2 are uniform in [0, 1], drawn anew
    for each particle and coordinate. Parameters: ω = 0.5, c1 = 0.5, c2 = 2, 10 particles (the paper).

    Source: Kennedy and Eberhart, "Particle swarm optimization", ICNN 1995, with the inertia weight of Shi and
    Eberhart, 1998. Where they and the paper are silent: a generation moves as one, after all its scores are
    in; the first velocities are (u - x)/2 with u uniform in the box, and a particle that leaves the box is
    put on its wall with no velocity across it (both as in Clerc's Standard PSO 2007); speed has no limit.
    """

    inertia: ClassVar[float] = 0.5
    cognitive: ClassVar[float] = 0.5
    social: ClassVar[float] = 2.0

    arrays: ClassVar[tuple[str, ...]] = (*Population.arrays, "velocities")

    def __init__(
        self,
        low: Sequence[float] | FloatArray,
        high: Sequence[float] | FloatArray,
        random: np.random.Generator,
        size: int = POPULATION,
    ) -> None:
        super().__init__(low, high, random, size)
        self.velocities = self._first_velocities(self.positions)

    def _move(self, better: BoolArray) -> None:
        best = self.kept[self.kept_scores.argmin()]
        self._fly(self.kept - self.positions, best - self.positions)

    def _fly(self, first: FloatArray, second: FloatArray) -> None:
        """Set velocities to ω v + c1 r1 first + c2 r2 second and move by them; stop at the walls."""
        r1, r2 = self._random.random((2, *self.positions.shape))
        flown = self.inertia * self.velocities + self.cognitive * r1 * first + self.social * r2 * second
        reached = self.positions + flown
        self.positions = np.clip(reached, self.low, self.high)
        self.velocities = np.where(reached == self.positions, flown, 0.0)

    def _first_velocities(self, positions: FloatArray) -> FloatArray:
        """Return velocities that lead half way to points uniform in the box."""
        return (self._draw(len(positions)) - positions) / 2


class Pso(PopulationOptimizer):
    """Particle swarm optimization over codes; see `ParticleSwarm`."""

    name = "pso"
    core = ParticleSwarm
