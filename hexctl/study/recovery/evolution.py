"""CMA-ES among shapes of gaits, by trials on the failed robot.

After N. Hansen, "The CMA Evolution Strategy: A Tutorial", arXiv 1604.00772 (2016), with its constants.
"""

import math

import numpy as np

from hexctl.study.recovery.shaped_walk import ShapeSearch
from hexctl.types import FloatArray

#: First standard deviation of each number of a shape.
FIRST_STEP = 0.15

#: Maximum number of trials, as many as `open-loop-best` makes.
MOST_TRIALS = 40


class EvolutionSearch(ShapeSearch):
    """CMA-ES that begins with a shape, (6, 4)."""

    def __init__(self, first: FloatArray, seed: int) -> None:
        self._shape, self._mean = first.shape, first.ravel().copy()
        self._random, n = np.random.default_rng(seed), first.size
        self.size = 4 + int(3 * math.log(n))
        raw = math.log((self.size + 1) / 2) - np.log(np.arange(1, self.size // 2 + 1))
        self._weights = raw / raw.sum()
        mass = 1 / (self._weights**2).sum()
        self._c_step = (mass + 2) / (n + mass + 5)
        self._damping = 1 + 2 * max(0.0, math.sqrt((mass - 1) / (n + 1)) - 1) + self._c_step
        self._c_path = (4 + mass / n) / (n + 4 + 2 * mass / n)
        self._c_one = 2 / ((n + 1.3) ** 2 + mass)
        self._c_many = min(1 - self._c_one, 2 * (mass - 2 + 1 / mass) / ((n + 2) ** 2 + mass))
        self._mass, self._expected = mass, math.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n * n))
        self._step, self._covariance = FIRST_STEP, np.eye(n)
        self._step_path, self._path = np.zeros(n), np.zeros(n)
        self._trials = 0
        self._draw()

    def ask(self) -> list[FloatArray]:
        """The shapes of a generation, within 0 to 1."""
        if self._trials + self.size > MOST_TRIALS:
            return []
        positions = np.clip(self._mean + self._step * self._moves, 0.0, 1.0)
        return [one.reshape(self._shape) for one in positions]

    def tell(self, scores: FloatArray) -> None:
        """Move on to the next generation."""
        self._trials += len(scores)
        best = self._moves[np.argsort(-scores)[: self._weights.size]]
        move = self._weights @ best
        self._mean = self._mean + self._step * move
        spread, axes = np.linalg.eigh(self._covariance)
        whitened = axes @ ((axes.T @ move) / np.sqrt(spread))
        c_step, c_path, n = self._c_step, self._c_path, move.size
        self._step_path = (1 - c_step) * self._step_path + math.sqrt(
            c_step * (2 - c_step) * self._mass
        ) * whitened
        length = float(np.linalg.norm(self._step_path))
        generations = self._trials / self.size
        stalled = (
            length / math.sqrt(1 - (1 - c_step) ** (2 * generations)) >= (1.4 + 2 / (n + 1)) * self._expected
        )
        along = 0.0 if stalled else math.sqrt(c_path * (2 - c_path) * self._mass)
        self._path = (1 - c_path) * self._path + along * move
        many = (best.T * self._weights) @ best
        kept = 1 - self._c_one - self._c_many
        self._covariance = (
            kept * self._covariance + self._c_one * np.outer(self._path, self._path) + self._c_many * many
        )
        self._step *= math.exp(c_step / self._damping * (length / self._expected - 1))
        self._draw()

    def _draw(self) -> None:
        spread, axes = np.linalg.eigh(self._covariance)
        normal = self._random.standard_normal((self.size, self._mean.size))
        self._moves = normal * np.sqrt(spread) @ axes.T
