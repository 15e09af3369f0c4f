"""All optimizers, bare and counted by FreshCodes, keep to the one interface."""

from collections.abc import Callable

import numpy as np
import pytest

from hexctl.adapt.catalogue import OPTIMIZERS, make_optimizer
from hexctl.adapt.counting import FreshCodes
from hexctl.adapt.optimizer import Optimizer
from hexctl.adapt.population import PopulationOptimizer
from hexctl.adapt.space import GaitSpace
from tests.adapt.conformance import BATCHES, Make, OptimizerConformance
from tests.adapt.searching import ONE_FAILED, search


def bare(name: str) -> Make:
    return lambda space, seed: make_optimizer(name, space, seed)


def fresh(name: str) -> Make:
    return lambda space, seed: FreshCodes(make_optimizer(name, space, seed), seed)


def paper(name: str) -> Make:
    return lambda space, seed: FreshCodes(make_optimizer(name, space, seed), seed, paper_count=True)


@pytest.mark.parametrize("name", OPTIMIZERS)
@pytest.mark.parametrize("counting", [bare, fresh, paper], ids=lambda counting: counting.__name__)
class TestOptimizers(OptimizerConformance):
    @pytest.fixture
    def make(self, name: str, counting: Callable[[str], Make]) -> Make:
        return counting(name)


@pytest.mark.parametrize("name", OPTIMIZERS)
@pytest.mark.parametrize("counting", [bare, paper], ids=lambda counting: counting.__name__)
def test_the_size_of_the_pieces_does_not_change_the_search(
    name: str, counting: Callable[[str], Make]
) -> None:
    first, *others = [search(counting(name)(ONE_FAILED, 3), 150, batch=batch) for batch in BATCHES]
    assert all(codes == first for codes in others)


def found_best(make: Callable[[GaitSpace, int], Optimizer], trials: int, best: int, seeds: int) -> float:
    """Return in which part of the searches the best code was among the first trials."""
    return float(
        np.mean(
            [
                best in search(make(ONE_FAILED, seed), trials, landscape=lambda code: float(abs(code - best)))
                for seed in range(seeds)
            ]
        )
    )


@pytest.mark.parametrize(
    "name", [name for name, kind in OPTIMIZERS.items() if issubclass(kind, PopulationOptimizer)]
)
@pytest.mark.parametrize("best", [12, 45, 77, 111])
def test_searches_find_the_best_of_a_smooth_landscape_far_sooner_than_chance(name: str, best: int) -> None:
    # 60 of 120 codes contain the best one with probability 1/2: 27 or more of 30 have probability 4e-6.
    assert found_best(fresh(name), trials=60, best=best, seeds=30) >= 27 / 30


def test_random_finds_the_best_by_chance() -> None:
    # 200 searches: 0.5 ± 0.035 (one standard deviation).
    assert found_best(bare("random"), trials=60, best=45, seeds=200) == pytest.approx(0.5, abs=0.15)
