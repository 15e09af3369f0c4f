"""Differential evolution against SciPy's, and its rules one by one."""

from typing import ClassVar

import numpy as np
import pytest
from scipy.optimize import differential_evolution
from scipy.stats import mannwhitneyu

from hexctl.adapt.differential_evolution import BestEvolution, DifferentialEvolution, RandomEvolution
from hexctl.types import FloatArray
from tests.adapt.continuous import HIGH, LOW, Function, make, minimum, rosenbrock, sphere

SEEDS = 150
GENERATIONS = 25


def ours(core: type[DifferentialEvolution], function: Function) -> FloatArray:
    """Return the logarithms of the minima found with many seeds, (SEEDS,)."""
    return np.log10([minimum(core, function, GENERATIONS, seed) for seed in range(SEEDS)])


def scipys(strategy: str, function: Function, mutation: float = 0.7) -> FloatArray:
    """Return the same found by SciPy: 10 individuals, uniform start, whole generations, CR = 0.5."""
    runs = [
        differential_evolution(
            lambda points: function(points.T),
            [(LOW, HIGH)] * 2,
            strategy=strategy,
            popsize=5,  # times two dimensions
            init="random",
            maxiter=GENERATIONS - 1,  # besides the first generation
            mutation=mutation,
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


@pytest.mark.parametrize("function", [sphere, rosenbrock])
@pytest.mark.parametrize(("core", "strategy"), [(BestEvolution, "best1bin"), (RandomEvolution, "rand1bin")])
def test_it_converges_as_scipys_does(
    core: type[DifferentialEvolution], strategy: str, function: Function
) -> None:
    # 150 minima each: one from the other is told by rank (Mann-Whitney), and by their medians in decades.
    found, reference = ours(core, function), scipys(strategy, function)
    assert mannwhitneyu(found, reference).pvalue > 0.01
    assert np.median(found) == pytest.approx(np.median(reference), abs=0.5)


def test_the_comparison_would_notice_another_factor_or_strategy() -> None:
    found = ours(BestEvolution, sphere)
    assert mannwhitneyu(found, scipys("best1bin", sphere, mutation=0.6)).pvalue < 1e-3
    assert mannwhitneyu(found, scipys("rand1bin", sphere)).pvalue < 1e-9


class NoCrossover(BestEvolution):
    crossover: ClassVar[float] = 0.0


class FullCrossover(BestEvolution):
    crossover: ClassVar[float] = 1.0


def differing(core: type[DifferentialEvolution]) -> FloatArray:
    """Return in how many coordinates each challenger differs from its parent, in five dimensions."""
    counts = []
    for seed in range(40):
        population = make(core, seed, 5)
        population.advance(sphere(population.positions))
        counts.append((population.positions != population.kept).sum(axis=1))
    return np.concatenate(counts)


def test_crossover_takes_one_coordinate_for_certain_and_the_others_by_chance() -> None:
    assert set(differing(NoCrossover)) == {1}
    assert set(differing(FullCrossover)) == {5}
    # 1 + 4 CR = 3 of 5; 400 challengers, standard error 0.05.
    assert differing(BestEvolution).mean() == pytest.approx(3.0, abs=0.2)


def test_in_one_dimension_the_crossover_rate_has_no_effect() -> None:
    none, full = make(NoCrossover, 3, 1), make(FullCrossover, 3, 1)
    for _ in range(30):
        np.testing.assert_array_equal(none.positions, full.positions)
        none.advance(sphere(none.positions))
        full.advance(sphere(full.positions))


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


def test_a_challenger_wins_with_a_better_or_equal_score_only() -> None:
    population = make(BestEvolution, 5)
    population.advance(np.full(10, 1.0))
    parents, challengers = population.kept.copy(), population.positions.copy()
    population.advance(np.array([0.5, 1.0, 1.5, 1e9, 0.9, 1.0, 2.0, 3.0, 4.0, 5.0]))
    won = [0, 1, 4, 5]
    np.testing.assert_array_equal(population.kept[won], challengers[won])
    lost = [2, 3, 6, 7, 8, 9]
    np.testing.assert_array_equal(population.kept[lost], parents[lost])
