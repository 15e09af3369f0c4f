"""What all populations share, on their continuous cores."""

import json
from typing import ClassVar

import numpy as np
import pytest

from hexctl.adapt.population import Population, PopulationOptimizer
from hexctl.adapt.registry import OPTIMIZERS
from hexctl.adapt.swarm import Pso
from hexctl.testing.optimizers import ONE_FAILED
from tests.adapt.continuous import HIGH, LOW, make, minimum, rosenbrock, sphere

CORES = [kind.core for kind in OPTIMIZERS.values() if issubclass(kind, PopulationOptimizer)]


@pytest.mark.parametrize("core", CORES)
@pytest.mark.parametrize("dimension", [1, 2, 5])
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
def test_the_best_value_of_continuous_functions_falls_below_random_search(core: type[Population]) -> None:
    for function in (sphere, rosenbrock):
        found = [minimum(core, function, 30, seed) for seed in range(30)]
        random = np.random.default_rng(0).uniform(LOW, HIGH, size=(30, 300, 2))
        by_chance = function(random).min(axis=1)
        assert np.median(found) < np.median(by_chance) / 3


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


def test_the_others_are_distinct_not_oneself_and_all_alike() -> None:
    population = make(Pso.core, 5)
    counts = np.zeros((10, 10), dtype=int)
    for _ in range(3000):
        chosen = population._others(3)
        assert chosen.shape == (3, 10)
        for individual in range(10):
            assert len({individual, *chosen[:, individual].tolist()}) == 4
        counts[np.arange(10), chosen[0]] += 1
    # Each of the nine others comes first 333 times; the standard deviation is 17.
    assert np.abs(counts[~np.eye(10, dtype=bool)] - 3000 / 9).max() < 5 * 17


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


def test_one_ask_does_not_reach_into_the_next_generation() -> None:
    optimizer = Pso(ONE_FAILED, 0)
    pieces = []
    for _ in range(6):
        codes = optimizer.ask(4)
        optimizer.tell(codes, [float(code) for code in codes])
        pieces.append(len(codes))
    assert pieces == [4, 4, 2, 4, 4, 2]
