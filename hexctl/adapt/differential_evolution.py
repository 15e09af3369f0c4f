"""`debest` and `derand`: differential evolution, DE/best/1/bin and DE/rand/1/bin."""

from abc import abstractmethod
from typing import ClassVar

import numpy as np

from hexctl.adapt.population import Population, PopulationOptimizer
from hexctl.types import BoolArray, FloatArray


class DifferentialEvolution(Population):
    """Differential evolution with binomial crossover.

    Each parent x_i is challenged by u_i and gives way when f(u_i) <= f(x_i):

        v_i  = b_i + F (x_r - x_s)
        u_ij = v_ij  where rand_ij < CR or j = j_i,  else x_ij

    j_i is one coordinate drawn for each i; r and s are distinct and neither is i; the strategy says what b
    is. Parameters: CR = 0.5, F = 0.7, 10 individuals (the paper). In one dimension, as with codes, the only
    coordinate is always j_i: u_i = v_i, and CR has no effect.

    Source: Storn and Price, "Differential evolution", Journal of Global Optimization 11, 1997. Where they and
    the paper are silent, as in SciPy: coordinates outside the box are redrawn, uniform in it, and a
    challenger of equal score wins. A generation moves as one (SciPy's `updating="deferred"`).
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


class DeBest(PopulationOptimizer):
    """DE/best/1/bin over codes; see `DifferentialEvolution` and `BestEvolution`."""

    name = "debest"
    core = BestEvolution


class DeRand(PopulationOptimizer):
    """DE/rand/1/bin over codes; see `DifferentialEvolution` and `RandomEvolution`."""

    name = "derand"
    core = RandomEvolution
