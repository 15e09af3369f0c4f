"""The populations on their continuous cores, by the equations of their papers."""

import json
from collections.abc import Callable
from typing import ClassVar

import numpy as np
import pytest

from hexctl.adapt.optimizers.population import (
    BestEvolution,
    DifferentialEvolution,
    DifferentialSwarm,
    ParticleSwarm,
    Population,
    PopulationOptimizer,
    RandomEvolution,
    SpeciatedSwarm,
)
from hexctl.adapt.optimizers.shipped import OPTIMIZERS
from hexctl.testing.optimizer_conformance import ONE_FAILED
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


CORES = [kind.core for kind in OPTIMIZERS.values() if issubclass(kind, PopulationOptimizer)]


@pytest.mark.parametrize("core", CORES)
@pytest.mark.parametrize("dimension", [1, 5])
def test_positions_stay_in_the_box(core: type[Population], dimension: int) -> None:
    population = make(core, 0, dimension)
    for _ in range(60):
        assert population.positions.shape == (10, dimension)
        assert (population.positions >= LOW).all()
        assert (population.positions <= HIGH).all()
        # The best point is a corner, so that the walls are met.
        population.advance(population.positions.sum(axis=1))


@pytest.mark.parametrize("core", CORES)
def test_each_individual_keeps_its_best(core: type[Population]) -> None:
    population = make(core, 1)
    best = np.full(10, np.inf)
    for _ in range(40):
        scores = sphere(population.positions)
        best = np.minimum(best, scores)
        population.advance(scores)
        np.testing.assert_array_equal(population.kept_scores, best)
        np.testing.assert_array_equal(sphere(population.kept), best)


@pytest.mark.parametrize("core", CORES)
def test_only_the_order_of_scores_matters(core: type[Population]) -> None:
    plain, stretched = make(core, 2), make(core, 2)
    for _ in range(30):
        scores = sphere(plain.positions)
        plain.advance(scores)
        stretched.advance(np.exp(scores) * 1e9)
        np.testing.assert_array_equal(plain.positions, stretched.positions)


@pytest.mark.parametrize("core", CORES)
def test_a_core_is_restored_exactly(core: type[Population]) -> None:
    original, restored = make(core, 3), make(core, 4)
    for _ in range(8):
        original.advance(sphere(original.positions))
        restored.advance(sphere(restored.positions))
    restored.restore(json.loads(json.dumps(original.state(), allow_nan=False)))
    for name in core.arrays:
        np.testing.assert_array_equal(getattr(restored, name), getattr(original, name))
        assert getattr(restored, name).dtype == getattr(original, name).dtype


@pytest.mark.parametrize("core", CORES)
def test_a_state_of_another_shape_is_refused(core: type[Population]) -> None:
    with pytest.raises(ValueError, match="reshape"):
        make(core, 0, 2).restore(make(core, 0, 3).state())


class Fixed(Population):
    """Individuals that stand where they are told."""

    places: ClassVar[list[float]] = [1.0, 1.49, 1.51, 2.2, 60.5, 77.4999, 119.4, 119.6, 120.0, 3.0]

    def _move(self, better: object) -> None:
        self.positions = np.array(self.places)[:, np.newaxis]


class FixedSearch(PopulationOptimizer):
    name = "fixed"
    core = Fixed


def test_the_code_is_the_nearest_whole_number() -> None:
    optimizer = FixedSearch(ONE_FAILED, 0)
    optimizer.tell(optimizer.ask(10), [1.0] * 10)
    assert optimizer.ask(10) == [1, 1, 2, 2, 61, 77, 119, 120, 120, 3]


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


def test_a_particle_that_leaves_the_box_stops_at_the_wall() -> None:
    swarm = make(ParticleSwarm, 0)
    assert isinstance(swarm, ParticleSwarm)
    swarm.velocities[:] = [[200.0, 0.0]]
    swarm.advance(sphere(swarm.positions))
    np.testing.assert_array_equal(swarm.positions[:, 0], np.full(10, HIGH))
    np.testing.assert_array_equal(swarm.velocities[:, 0], np.zeros(10))
    assert (np.abs(swarm.velocities[:, 1]) > 0).sum() >= 9  # free along the wall; the best one rests


class Small(SpeciatedSwarm):
    most_per_species: ClassVar[int] = 3
    radius: ClassVar[float] = 2.0


def scored(core: type[SpeciatedSwarm], places: list[float]) -> SpeciatedSwarm:
    """A swarm in the box [1, 101] that remembers these places, best first."""
    swarm = core([1.0], [101.0], np.random.default_rng(0), len(places))
    swarm.kept = np.array(places)[:, np.newaxis]
    swarm.kept_scores = np.arange(len(places), dtype=float)
    swarm.known[:] = True
    return swarm


def test_a_particle_joins_the_first_seed_within_a_tenth_of_the_range() -> None:
    #                               seed  near  seed  seed  near both: joins the fitter  at r    beyond
    swarm = scored(SpeciatedSwarm, [50.0, 57.0, 64.0, 10.0, 58.0, 20.0, 30.5])
    np.testing.assert_array_equal(swarm.species(), [0, 0, 2, 3, 0, 3, 6])


def test_in_a_box_of_unequal_sides_each_side_counts_alike() -> None:
    swarm = SpeciatedSwarm([0.0, 0.0], [1.0, 1000.0], np.random.default_rng(0), 4)
    swarm.kept = np.array([[0.5, 500.0], [0.5, 590.0], [0.59, 500.0], [0.5, 610.0]])
    swarm.kept_scores = np.arange(4.0)
    np.testing.assert_array_equal(swarm.species(), [0, 0, 0, 3])


def test_a_crowded_species_keeps_its_best_and_redraws_the_rest() -> None:
    swarm = make(Small, 9)
    best = np.inf
    for _ in range(20):
        scores = sphere(swarm.positions)
        better = np.where(swarm.known, np.minimum(scores, swarm.kept_scores), scores)
        best = min(best, scores.min())
        swarm.advance(scores)
        np.testing.assert_array_equal(swarm.kept_scores, better)  # the redrawn have forgotten
        np.testing.assert_array_equal(np.flatnonzero(swarm.known), np.sort(np.argsort(better)[:3]))
        assert swarm.kept_scores.min() == best


def swarm_of(seed: int, dimension: int = 2) -> DifferentialSwarm:
    swarm = make(DifferentialSwarm, seed, dimension)
    assert isinstance(swarm, DifferentialSwarm)
    return swarm


def test_the_archive_holds_the_last_ten_successes_and_starts_as_generation_1() -> None:
    swarm = swarm_of(0)
    successes: list[tuple[float, ...]] = []
    idle = np.zeros(10, dtype=int)
    best = np.full(10, np.inf)
    for _ in range(30):
        positions, scores = swarm.positions.copy(), sphere(swarm.positions)
        for particle in range(10):
            if scores[particle] < best[particle]:
                best[particle], idle[particle] = scores[particle], 0
                successes.append(tuple(positions[particle]))
            else:
                idle[particle] += 1
        swarm.advance(scores)
        np.testing.assert_array_equal(swarm.archive, successes[-10:])
        np.testing.assert_array_equal(swarm.archive_scores, sphere(np.array(successes[-10:])))
        np.testing.assert_array_equal(swarm.idle, idle)


def moved(idle: int, seed: int = 1) -> tuple[DifferentialSwarm, FloatArray]:
    """A swarm after one fruitless generation at rest, and where it stood; it was idle before.

    Memories lie at -1, the best one at -2; the archive at 3, its best at 4.
    """
    swarm = swarm_of(seed, 1)
    swarm.kept = np.full((10, 1), -1.0)
    swarm.kept[9] = -2.0
    swarm.kept_scores = np.array([1.0] * 9 + [0.0])
    swarm.archive = np.full((10, 1), 3.0)
    swarm.archive[0] = 4.0
    swarm.archive_scores = np.array([0.5] + [1.0] * 9)
    swarm.known[:] = True
    swarm.velocities[:] = 0.0
    swarm.idle[:] = idle
    before = swarm.positions.copy()
    swarm.advance(np.full(10, 1e9))
    return swarm, before


def test_a_particle_follows_the_best_and_a_difference_of_memories() -> None:
    swarm, before = moved(idle=2)  # now 3: not more than Q
    # v = 0.5 r1 (p_a - p_b) + 2 r2 (-2 - x), and memories differ by at most 1.
    pulled = 2.0 * (-2.0 - before)
    reach = 0.5
    low, high = np.minimum(pulled, 0.0) - reach, np.maximum(pulled, 0.0) + reach
    assert ((swarm.velocities >= low - 1e-12) & (swarm.velocities <= high + 1e-12)).all()
    assert len(np.unique(swarm.velocities / pulled)) > 5


def test_a_stagnating_particle_takes_its_parents_from_the_archive() -> None:
    for seed in range(20):
        swarm, _ = moved(idle=3, seed=seed)  # now 4: more than Q = 3
        # From 3, its place in the archive, toward 4, and aside by half a difference of at most 1.
        assert (swarm.positions >= 2.5 - 1e-12).all()
        # The first starts at 4, where there is nothing to go toward.
        assert abs(swarm.positions[0, 0] - 4.0) <= 0.5


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


def test_a_challenger_wins_with_a_better_or_equal_score_only() -> None:
    population = make(BestEvolution, 5)
    population.advance(np.full(10, 1.0))
    parents, challengers = population.kept.copy(), population.positions.copy()
    population.advance(np.array([0.5, 1.0, 1.5, 1e9, 0.9, 1.0, 2.0, 3.0, 4.0, 5.0]))
    won = [0, 1, 4, 5]
    np.testing.assert_array_equal(population.kept[won], challengers[won])
    lost = [2, 3, 6, 7, 8, 9]
    np.testing.assert_array_equal(population.kept[lost], parents[lost])
