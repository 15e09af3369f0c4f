"""Particle swarms `pso`, `psosp`, `dps`; differential evolution `debest`, `derand`.

The continuous cores (`Population` and its subclasses) have any dimension; `PopulationOptimizer` puts them
behind ask and tell of codes.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from hexctl.adapt.optimizer import Optimizer
from hexctl.adapt.space import GaitSpace
from hexctl.types import BoolArray, FloatArray

IntArray = NDArray[np.int64]

#: Individuals in a generation (the paper's population size).
POPULATION = 10


class Population(ABC):
    """Individuals in the box [low, high] that are scored and move together, once a generation.

    Generation 1 is uniform in the box. Scores are only compared, so large ones do no harm.

    Attributes:
        positions: to be scored, (size, dimension).
        kept: the best position of each individual so far, (size, dimension): a particle's memory, or the
            parents of differential evolution.
        kept_scores: the scores of `kept`, (size,); meaningless if not `known`.
        known: which individuals have been scored since they were drawn, (size,).
    """

    #: Whether a new position replaces a kept one of equal score.
    takes_ties: ClassVar[bool] = False
    #: The arrays that make up the state.
    arrays: ClassVar[tuple[str, ...]] = ("positions", "kept", "kept_scores", "known")

    def __init__(
        self,
        low: Sequence[float] | FloatArray,
        high: Sequence[float] | FloatArray,
        random: np.random.Generator,
        size: int = POPULATION,
    ) -> None:
        self.low, self.high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
        self.size = size
        self._random = random
        self._begin()

    def _begin(self) -> None:
        """Draw generation 1; a subclass adds its own arrays."""
        self.positions = self._draw(self.size)
        self.kept = self.positions.copy()
        self.kept_scores = np.zeros(self.size)
        self.known: BoolArray = np.zeros(self.size, dtype=bool)

    def advance(self, scores: FloatArray) -> None:
        """Take the scores of `positions`, (size,), and move on to the next generation."""
        better = scores <= self.kept_scores if self.takes_ties else scores < self.kept_scores
        better |= ~self.known
        self.kept = np.where(better[:, np.newaxis], self.positions, self.kept)
        self.kept_scores = np.where(better, scores, self.kept_scores)
        self.known = np.ones(self.size, dtype=bool)
        self._move(better)

    def state(self) -> dict[str, Any]:
        """All arrays as lists, without the caller's random stream."""
        return {name: getattr(self, name).tolist() for name in self.arrays}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore the result of `state`; raises KeyError or ValueError for anything else."""
        for name in self.arrays:
            present = getattr(self, name)
            setattr(self, name, np.array(state[name], dtype=present.dtype).reshape(present.shape))

    @abstractmethod
    def _move(self, better: BoolArray) -> None:
        """Set the next `positions`; `better`, (size,), are individuals that improved."""

    def _draw(self, count: int) -> FloatArray:
        """Points uniform in the box, (count, dimension)."""
        return self._random.uniform(self.low, self.high, size=(count, self.low.size))

    def _others(self, count: int) -> IntArray:
        """Indices of `count` other individuals for each, all distinct, (count, size)."""
        lots = self._random.random((self.size, self.size))
        np.fill_diagonal(lots, np.inf)
        return np.argsort(lots, axis=1)[:, :count].T


class PopulationOptimizer(Optimizer):
    """A population in the one-dimensional box [1, size]; the code is the nearest whole number.

    A generation is handed out in pieces that do not change the search; an ask stays within it.
    """

    #: Rule by which the population moves.
    core: ClassVar[type[Population]]

    def __init__(self, space: GaitSpace, seed: int) -> None:
        super().__init__(space, seed)
        self._population = self.core([1.0], [float(space.size)], self._random)
        self._scores: list[float] = []

    def _suggest(self, count: int) -> list[int]:
        done = len(self._scores)
        nearest = np.floor(self._population.positions[done : done + count, 0] + 0.5)
        return [int(code) for code in nearest]

    def _learn(self, codes: list[int], scores: list[float]) -> None:
        self._scores += scores
        if len(self._scores) == self._population.size:
            self._population.advance(np.array(self._scores))
            self._scores = []

    def _search_state(self) -> dict[str, Any]:
        return {"scores": list(self._scores), "population": self._population.state()}

    def _restore_search(self, state: dict[str, Any]) -> None:
        self._scores = [float(score) for score in state["scores"]]
        self._population.restore(state["population"])


class ParticleSwarm(Population):
    """A swarm that follows its global best.

        v ← ω v + c1 r1 (p - x) + c2 r2 (g - x),   x ← x + v

    p is the particle's best position so far, g the best of all; r1 and r2 are uniform in [0, 1], drawn for
    each particle and coordinate. Parameters: ω = 0.5, c1 = 0.5, c2 = 2, 10 particles (the paper).

    Source: Kennedy and Eberhart, "Particle swarm optimization", ICNN 1995, with the inertia weight of Shi and
    Eberhart, 1998. Not specified there: a generation moves together; the first velocities are (u - x)/2 with
    u uniform in the box, and a particle stops at the walls (both as in Clerc's Standard PSO 2007).
    """

    inertia: ClassVar[float] = 0.5
    cognitive: ClassVar[float] = 0.5
    social: ClassVar[float] = 2.0

    arrays: ClassVar[tuple[str, ...]] = (*Population.arrays, "velocities")

    def _begin(self) -> None:
        super()._begin()
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
        return (self._draw(len(positions)) - positions) / 2


class SpeciatedSwarm(ParticleSwarm):
    """A swarm whose particles follow the seed of their species instead of one global best.

    Every generation the particles are sorted by their best scores, best first. Each joins the first seed
    within radius r of the best position that it had, else it becomes a seed itself. Then

        v ← ω v + c1 r1 (p - x) + c2 r2 (s - x),   x ← x + v

    with p the particle's own best position and s its seed's. A species of more than Pmax particles keeps its
    best Pmax; the rest are redrawn and lose their memory. Parameters as in `pso`, r = 0.1 of the range
    (Euclidean, each coordinate scaled by its range), Pmax = 10.

    Source: Parrott and Li, "Locating and tracking multiple dynamic optima by a particle swarm model using
    speciation", IEEE TEVC 10(4), 2006, doi 10.1109/TEVC.2005.859468, without new scores of the seeds, as
    optima do not move. The paper states neither r nor Pmax. Pmax = 10 is DEAP's value, made for 100
    particles; 10 never reach it.
    """

    radius: ClassVar[float] = 0.1
    most_per_species: ClassVar[int] = 10

    def species(self) -> IntArray:
        """Index of the seed of each particle's species, (size,)."""
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
        order = np.argsort(self.kept_scores, kind="stable")
        return [
            int(particle)
            for seed in np.flatnonzero(np.bincount(seeds) > self.most_per_species)
            for particle in order[seeds[order] == seed][self.most_per_species :]
        ]


class DifferentialSwarm(ParticleSwarm):
    """Particles moved by difference vectors, with parents from an archive of successes on stagnation.

    This is a RECONSTRUCTION of DPS (Parque, "differential particle scheme with successive parent selection",
    CEC 2021) from its title and two published parents, as no open source has its equations:

        v ← ω v + c1 r1 (p_a - p_b) + c2 r2 (p_g - x),   x ← x + v

    p_a and p_b are the best positions of two other particles, as in PSO with differentially perturbed
    velocity (Das, Konar, Chakraborty, GECCO 2005); p_g is the best of all. When a particle has not improved
    its best for more than Q generations, p_a, p_b and p_g come from an archive of the last 10 successes, and
    its x becomes the archive's i-th; a success is a position that improved its particle's best. That is Guo,
    Yang, Hsu, Tsai, "Improving differential evolution with a successful-parent-selecting framework", IEEE
    TEVC 19(5), 2015, and as in its authors' code the archive starts as generation 1.

    Parameters: ω = 0.5, c1 = 0.5, c2 = 2, 10 particles (the paper's, for swarms), Q = 3.

    Assumed: the form of the velocity, that c1 weighs the difference, and Q: Guo's Q = 70 would never act in
    the paper's 12 generations. The original may differ in all of these, and may accept only moves that
    improve. Results of `dps` are not results of Parque's DPS.
    """

    patience: ClassVar[int] = 3

    arrays: ClassVar[tuple[str, ...]] = (*ParticleSwarm.arrays, "idle", "archive", "archive_scores")

    def _begin(self) -> None:
        super()._begin()
        self.idle: IntArray = np.zeros(self.size, dtype=np.int64)  # generations without success
        self.archive = self.positions.copy()
        self.archive_scores = np.zeros(self.size)

    def _move(self, better: BoolArray) -> None:
        self._remember(better)
        stuck = (self.idle > self.patience)[:, np.newaxis]
        plus, minus = (np.where(stuck, self.archive[i], self.kept[i]) for i in self._others(2))
        best_of_archive = self.archive[self.archive_scores.argmin()]
        best = np.where(stuck, best_of_archive, self.kept[self.kept_scores.argmin()])
        self.positions = np.where(stuck, self.archive, self.positions)
        self._fly(plus - minus, best - self.positions)

    def _remember(self, better: BoolArray) -> None:
        self.idle = np.where(better, 0, self.idle + 1)
        self.archive = np.concatenate([self.archive, self.kept[better]])[-self.size :]
        scores = np.concatenate([self.archive_scores, self.kept_scores[better]])
        self.archive_scores = scores[-self.size :]


class DifferentialEvolution(Population):
    """Differential evolution with binomial crossover.

    Each parent x_i is challenged by u_i and gives way when f(u_i) <= f(x_i):

        v_i  = b_i + F (x_r - x_s)
        u_ij = v_ij  where rand_ij < CR or j = j_i,  else x_ij

    j_i is one coordinate drawn for each i; r and s are distinct and neither is i; the strategy defines b.
    Parameters: CR = 0.5, F = 0.7, 10 individuals (the paper). In one dimension, as with codes, u_i = v_i.

    Source: Storn and Price, "Differential evolution", Journal of Global Optimization 11, 1997. Not specified
    there, as in SciPy: coordinates outside the box are redrawn, uniform in it, and a challenger of equal
    score wins. A generation moves together (SciPy's `updating="deferred"`).
    """

    crossover: ClassVar[float] = 0.5
    scale: ClassVar[float] = 0.7
    takes_ties = True
    #: Number of partners in the mutation of one individual.
    partners: ClassVar[int]

    def _move(self, better: BoolArray) -> None:
        mutants = self._mutants(self.kept[self._others(self.partners)])
        crossed = self._random.random(mutants.shape) < self.crossover
        certain = self._random.integers(self.low.size, size=self.size)
        crossed[np.arange(self.size), certain] = True
        trials = np.where(crossed, mutants, self.kept)
        outside = (trials < self.low) | (trials > self.high)
        self.positions = np.where(outside, self._draw(self.size), trials)

    @abstractmethod
    def _mutants(self, partners: FloatArray) -> FloatArray:
        """Mutants v, (size, dimension), from the partners of each, (partners, size, dimension)."""


class BestEvolution(DifferentialEvolution):
    """DE/best/1/bin: b is the best parent of all, v_i = x_best + F (x_r - x_s)."""

    partners = 2

    def _mutants(self, partners: FloatArray) -> FloatArray:
        best = self.kept[self.kept_scores.argmin()]
        return np.asarray(best + self.scale * (partners[0] - partners[1]))


class RandomEvolution(DifferentialEvolution):
    """DE/rand/1/bin: b is a third partner, v_i = x_q + F (x_r - x_s), with q, r, s distinct and none i."""

    partners = 3

    def _mutants(self, partners: FloatArray) -> FloatArray:
        return np.asarray(partners[0] + self.scale * (partners[1] - partners[2]))


class SwarmSearch(PopulationOptimizer):
    """Search of codes by a `ParticleSwarm`."""

    name, core = "pso", ParticleSwarm


class SpeciatedSearch(PopulationOptimizer):
    """Search of codes by a `SpeciatedSwarm`."""

    name, core = "psosp", SpeciatedSwarm


class DifferentialSearch(PopulationOptimizer):
    """Search of codes by a `DifferentialSwarm`."""

    name, core = "dps", DifferentialSwarm


class BestEvolutionSearch(PopulationOptimizer):
    """Search of codes by `BestEvolution`."""

    name, core = "debest", BestEvolution


class RandomEvolutionSearch(PopulationOptimizer):
    """Search of codes by `RandomEvolution`."""

    name, core = "derand", RandomEvolution
