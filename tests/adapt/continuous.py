"""Continuous test functions, and a run of a population's core on them."""

from collections.abc import Callable

import numpy as np

from hexctl.adapt.optimizers.population import Population
from hexctl.types import FloatArray

Function = Callable[[FloatArray], FloatArray]

LOW, HIGH = -5.0, 5.0


def sphere(points: FloatArray) -> FloatArray:
    """Σ x², minimum 0 at 0; points (..., dimension)."""
    return np.asarray((points**2).sum(axis=-1))


def rosenbrock(points: FloatArray) -> FloatArray:
    """(1 - x)² + 100 (y - x²)², minimum 0 at (1, 1); points (..., 2)."""
    x, y = points[..., 0], points[..., 1]
    return np.asarray((1 - x) ** 2 + 100 * (y - x**2) ** 2)


def make(core: type[Population], seed: int, dimension: int = 2) -> Population:
    """A population of ten in the box."""
    return core([LOW] * dimension, [HIGH] * dimension, np.random.default_rng(seed))


def minimum(core: type[Population], function: Function, generations: int, seed: int) -> float:
    """The lowest value found in a number of generations."""
    population = make(core, seed)
    for _ in range(generations):
        population.advance(function(population.positions))
    return float(population.kept_scores.min())
