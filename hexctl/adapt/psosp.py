"""`psosp`: particle swarm optimization with speciation."""

from typing import ClassVar

import numpy as np

from hexctl.adapt.population import IntArray, PopulationOptimizer
from hexctl.adapt.pso import ParticleSwarm
from hexctl.types import BoolArray


class SpeciatedSwarm(ParticleSwarm):
    """A swarm whose particles follow the seed of their species instead of one global best.

    Every generation the particles are sorted by their best scores, best first. Each joins the first seed
    within radius r of its own best position, else it becomes a seed itself. Then

        v ← ω v + c1 r1 (p - x) + c2 r2 (s - x),   x ← x + v

    with p the particle's own best position and s its seed's. A species of more than Pmax particles keeps its
    best Pmax; the rest are drawn anew and forget what they knew. Parameters: ω, c1, c2 and 10 particles as in
    `pso` (the paper), r = 0.1 of the range (Euclidean, each coordinate scaled by its range), Pmax = 10.

    Source: Parrott and Li, "Locating and tracking multiple dynamic optima by a particle swarm model using
    speciation", IEEE TEVC 10(4), 2006, doi 10.1109/TEVC.2005.859468, as published implementations have it.
    Its answer to moving optima, scoring the seeds again, is left out: the best gait stands still. The paper
    states neither r nor Pmax. Pmax = 10 is DEAP's value, made for 100 particles; 10 particles never reach it.
    """

    radius: ClassVar[float] = 0.1
    most_per_species: ClassVar[int] = 10

    def species(self) -> IntArray:
        """Return for each particle which particle is the seed of its species, (size,)."""
        scaled = self.kept / (self.high - self.low)
        apart = np.linalg.norm(scaled[:, np.newaxis] - scaled, axis=-1)  # (size, size)
        near = (apart <= self.radius).tolist()
        joined = np.arange(self.size)
        seeds: list[int] = []
        for particle in np.argsort(self.kept_scores, kind="stable").tolist():
            joined[particle] = next((seed for seed in seeds if near[particle][seed]), particle)
            if joined[particle] == particle:
                seeds.append(particle)
        return joined

    def _move(self, better: BoolArray) -> None:
        seeds = self.species()
        self._fly(self.kept - self.positions, self.kept[seeds] - self.positions)
        crowded = self._crowded(seeds)
        if crowded:
            self.positions[crowded] = self._draw(len(crowded))
            self.velocities[crowded] = self._first_velocities(self.positions[crowded])
            self.known[crowded] = False

    def _crowded(self, seeds: IntArray) -> list[int]:
        """Return the particles beyond the best Pmax of their species."""
        order = np.argsort(self.kept_scores, kind="stable")
        return [
            int(particle)
            for seed in np.flatnonzero(np.bincount(seeds) > self.most_per_species)
            for particle in order[seeds[order] == seed][self.most_per_species :]
        ]


class Psosp(PopulationOptimizer):
    """Speciation particle swarm optimization over codes; see `SpeciatedSwarm`."""

    name = "psosp"
    core = SpeciatedSwarm
