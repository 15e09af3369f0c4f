"""The populations on their continuous cores, by the equations of their papers."""

from collections.abc import Callable
from typing import ClassVar

import numpy as np
import pytest

from hexctl.adapt.optimizers.population import (
    BestEvolution,
    DifferentialEvolution,
    ParticleSwarm,
    Population,
    RandomEvolution,
)
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


FAR = 1e9  # walls that are never met


class Certain(np.random.Generator):
    """A generator whose uniform numbers in [0, 1] are all 1: the deterministic swarm."""

    def random(self, size: object = None, *_: object, **__: object) -> FloatArray:  # type: ignore[override]
        return np.ones(size)  # type: ignore[call-overload, no-any-return]


class Tuned(ParticleSwarm):
    """A swarm in one dimension far from all walls, with other weights."""

    def __init__(
        self, inertia: float, cognitive: float, social: float, random: np.random.Generator, size: int
    ):
        super().__init__([-FAR], [FAR], random, size)
        self.weights = inertia, cognitive, social

    inertia: ClassVar[float] = property(lambda self: self.weights[0])  # type: ignore[assignment]
    cognitive: ClassVar[float] = property(lambda self: self.weights[1])  # type: ignore[assignment]
    social: ClassVar[float] = property(lambda self: self.weights[2])  # type: ignore[assignment]


def stagnating(swarm: ParticleSwarm, own: float, best: float, start: float, steps: int) -> FloatArray:
    """The positions of a swarm whose particles all remember `own` and follow `best`, (steps, size).

    Particle 0 is the one that holds the best.
    """
    swarm.positions = np.full((swarm.size, 1), start)
    swarm.velocities = np.zeros((swarm.size, 1))
    swarm.kept = np.full((swarm.size, 1), own)
    swarm.kept[0] = best
    swarm.kept_scores = np.ones(swarm.size)
    swarm.kept_scores[0] = 0.0
    swarm.known[:] = True
    path = []
    for _ in range(steps):
        swarm.advance(np.full(swarm.size, 2.0))  # never better
        path.append(swarm.positions[:, 0])
    return np.array(path)


@pytest.mark.parametrize(
    ("inertia", "cognitive", "social"), [(0.5, 0.5, 2.0), (0.7, 0.3, 0.3), (0.9, 1.0, 1.5)]
)
def test_without_chance_a_particle_moves_as_trelea_has_it(
    inertia: float, cognitive: float, social: float
) -> None:
    # Trelea 2003: x(t+1) = (1 + ω - φ) x(t) - ω x(t-1) + φ p, in closed form by the roots of λ² - ... = 0.
    swarm = Tuned(inertia, cognitive, social, Certain(np.random.PCG64(0)), 10)
    path = stagnating(swarm, own=3.0, best=8.0, start=-40.0, steps=30)[:, 1]
    weight = cognitive + social
    point = (cognitive * 3.0 + social * 8.0) / weight
    roots = np.roots([1, -(1 + inertia - weight), inertia])
    # x(0) = x(-1) = start, since the first velocity is 0.
    shares = np.linalg.solve(np.array([[1, 1], 1 / roots]), np.full(2, -40.0 - point))
    expected = [point + (shares * roots**step).sum().real for step in range(1, 31)]
    np.testing.assert_allclose(path, expected, rtol=1e-9, atol=1e-9)


SEEDS = 150

GENERATIONS = 25


def ours(core: type[DifferentialEvolution], function: Function) -> FloatArray:
    """Logarithms of the minima found with many seeds, (SEEDS,)."""
    return np.log10([minimum(core, function, GENERATIONS, seed) for seed in range(SEEDS)])


def scipys(strategy: str, function: Function) -> FloatArray:
    """The same found by SciPy: 10 individuals, uniform start, whole generations, CR = 0.5."""
    from scipy.optimize import differential_evolution

    runs = [
        differential_evolution(
            lambda points: function(points.T),
            [(LOW, HIGH)] * 2,
            strategy=strategy,
            popsize=5,  # times two dimensions
            init="random",
            maxiter=GENERATIONS - 1,  # besides the first generation
            mutation=0.7,
            recombination=0.5,
            updating="deferred",
            vectorized=True,
            polish=False,
            tol=0,
            atol=0,
            rng=1000 + seed,
        )
        for seed in range(SEEDS)
    ]
    assert {run.nit for run in runs} == {GENERATIONS - 1}
    return np.log10([run.fun for run in runs])


@pytest.mark.long
@pytest.mark.parametrize(
    ("core", "strategy", "function"),
    [(BestEvolution, "best1bin", rosenbrock), (RandomEvolution, "rand1bin", sphere)],
)
def test_it_converges_as_scipys_does(
    core: type[DifferentialEvolution], strategy: str, function: Function
) -> None:
    from scipy.stats import mannwhitneyu

    # 150 minima each: one from the other is told by rank (Mann-Whitney), and by their medians in decades.
    found, reference = ours(core, function), scipys(strategy, function)
    assert mannwhitneyu(found, reference).pvalue > 0.01
    assert np.median(found) == pytest.approx(np.median(reference), abs=0.5)


@pytest.mark.parametrize("core", [BestEvolution, RandomEvolution])
def test_challengers_are_made_of_the_parents_by_the_equation(core: type[DifferentialEvolution]) -> None:
    population = make(core, 4, 1)
    population.advance(sphere(population.positions))
    parents, best = population.kept[:, 0], population.kept_scores.argmin()
    for i, challenger in enumerate(population.positions[:, 0]):
        others = [j for j in range(10) if j != i]
        made = [
            parents[base] + 0.7 * (parents[r] - parents[s])
            for base in (others if core is RandomEvolution else [best])
            for r in others
            for s in others
            if r != s and (core is BestEvolution or base not in (r, s))
        ]
        outside = any(not LOW <= point <= HIGH for point in made)
        assert outside or min(abs(challenger - point) for point in made) < 1e-12
