"""What the population methods share: individuals in a box that move once a generation, and their codes.

The continuous core (`Population`) knows no gaits and has any dimension, so the very same core that searches
codes can be run on a continuous test function. `PopulationOptimizer` puts it behind ask and tell.
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

    Generation 1 is uniform in the box. Scores are only ever compared, never calculated with, so a large
    stand-in for a failed trial does no harm.

    Attributes:
        positions: where each individual is and wants to be scored, (size, dimension).
        kept: the best position of each individual so far, (size, dimension): a particle's memory, or the
            parents of differential evolution.
        kept_scores: the scores of `kept`, (size,); meaningless where not `known`.
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
        self.positions = self._draw(size)
        self.kept = self.positions.copy()
        self.kept_scores = np.zeros(size)
        self.known: BoolArray = np.zeros(size, dtype=bool)

    def advance(self, scores: FloatArray) -> None:
        """Take the scores of `positions`, (size,), and move on to the next generation."""
        better = scores <= self.kept_scores if self.takes_ties else scores < self.kept_scores
        better |= ~self.known
        self.kept = np.where(better[:, np.newaxis], self.positions, self.kept)
        self.kept_scores = np.where(better, scores, self.kept_scores)
        self.known = np.ones(self.size, dtype=bool)
        self._move(better)

    def state(self) -> dict[str, Any]:
        """All arrays as lists; the random stream belongs to the caller."""
        return {name: getattr(self, name).tolist() for name in self.arrays}

    def restore(self, state: dict[str, Any]) -> None:
        """Take over what `state` returned; raises KeyError or ValueError for anything else."""
        for name in self.arrays:
            present = getattr(self, name)
            setattr(self, name, np.array(state[name], dtype=present.dtype).reshape(present.shape))

    @abstractmethod
    def _move(self, better: BoolArray) -> None:
        """Set the next `positions`; `better`, (size,), says whose last position improved on its kept one."""

    def _draw(self, count: int) -> FloatArray:
        """Points uniform in the box, (count, dimension)."""
        return self._random.uniform(self.low, self.high, size=(count, self.low.size))

    def _others(self, count: int) -> IntArray:
        """Indices of `count` others for each individual, all distinct and none itself, (count, size)."""
        lots = self._random.random((self.size, self.size))
        np.fill_diagonal(lots, np.inf)
        return np.argsort(lots, axis=1)[:, :count].T


class PopulationOptimizer(Optimizer):
    """A population in the box [1, size] of codes, one dimension; the code is the nearest whole number.

    A generation is handed out in pieces of any size and told in pieces. One ask never reaches into the next
    generation, because that depends on all scores of this one; so the pieces do not change the search.
    """

    #: The rule by which the population moves.
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
