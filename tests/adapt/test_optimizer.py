"""All optimizers, bare and deduplicated, keep to the one interface; what an observation holds."""

from collections.abc import Callable

import numpy as np
import pytest

from hexctl.adapt.optimizer import Observation, Optimizer
from hexctl.adapt.optimizers.deduplication import Deduplication
from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.optimizers.population import PopulationOptimizer
from hexctl.adapt.optimizers.shipped import OPTIMIZERS
from hexctl.adapt.space import GaitSpace
from hexctl.control.trial_result import STATUSES
from hexctl.testing.optimizer_conformance import BATCHES, ONE_FAILED, Make, OptimizerConformance, search
from tests.adapt.walking import result_of


def bare(name: str) -> Make:
    return lambda space, seed: make_optimizer(name, space, seed)


def fresh(name: str) -> Make:
    return lambda space, seed: Deduplication(make_optimizer(name, space, seed), seed)


def paper(name: str) -> Make:
    return lambda space, seed: Deduplication(make_optimizer(name, space, seed), seed, paper_count=True)


#: Every optimizer bare, two as a session asks them, one with the paper's count.
SEARCHES = {
    **{name: bare(name) for name in OPTIMIZERS},
    "fresh exhaustive": fresh("exhaustive"),
    "fresh pso": fresh("pso"),
    "paper dps": paper("dps"),
}


@pytest.mark.parametrize("name", SEARCHES)
class TestOptimizers(OptimizerConformance):
    @pytest.fixture
    def make(self, name: str) -> Make:
        return SEARCHES[name]

    @pytest.fixture(autouse=True)
    def _without_random_numbers(self, name: str) -> None:
        self.seeded = "exhaustive" not in name


@pytest.mark.parametrize("name", OPTIMIZERS)
@pytest.mark.parametrize("counting", [bare, paper], ids=lambda counting: counting.__name__)
def test_the_size_of_the_pieces_does_not_change_the_search(
    name: str, counting: Callable[[str], Make]
) -> None:
    first, *others = [search(counting(name)(ONE_FAILED, 3), 150, batch=batch) for batch in BATCHES]
    assert all(codes == first for codes in others)


def found_best(make: Callable[[GaitSpace, int], Optimizer], trials: int, best: int, seeds: int) -> float:
    """Share of the searches in which the best code was among the first trials."""
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


def shown(points: int = 50, duration_s: float = 10.0, status: str = "ok") -> Observation:
    path = np.column_stack([np.arange(1.0, points + 1), -np.arange(1.0, points + 1)])
    return Observation(path_m=path, duration_s=duration_s, yaw_change_rad=0.1, status=status)


def test_it_is_what_the_result_has() -> None:
    result = result_of(-0.3)
    one = Observation.of(result)
    assert (one.duration_s, one.yaw_change_rad, one.status) == (30.0, 0.1, "ok")
    np.testing.assert_array_equal(one.path_m, result.path_m)


@pytest.mark.parametrize("status", STATUSES)
def test_only_walks_of_their_whole_time_are_finished(status: str) -> None:
    assert shown(status=status).finished == (status in ("ok", "no_progress"))


def test_a_row_of_the_path_belongs_to_the_time_at_its_end() -> None:
    rows = shown().at(np.array([0.2, 1.0, 5.0, 9.8, 10.0]))
    np.testing.assert_array_equal(rows[:, 0], [1, 5, 25, 49, 50])
    np.testing.assert_array_equal(rows[:, 1], -rows[:, 0])


def test_before_the_start_and_after_the_end_there_is_nothing() -> None:
    rows = shown().at(np.array([-1.0, 0.0, 10.2, 1e6]))
    assert np.isnan(rows).all()


def test_a_path_without_points_shows_nothing() -> None:
    nothing = Observation(path_m=np.zeros((0, 2)), duration_s=0.0, yaw_change_rad=None, status="fell")
    assert np.isnan(nothing.at(np.array([0.0, 1.0]))).all()


def test_how_finely_a_walk_was_kept_does_not_matter() -> None:
    fine = np.column_stack([np.linspace(0.002, 4, 1500), np.linspace(-0.001, -2, 1500)])
    times = np.arange(3.0, 30.1, 3.0)
    whole, thinned = (
        Observation(path_m=path, duration_s=30.0, yaw_change_rad=None, status="ok").at(times)
        for path in (fine, fine[9::10])
    )
    np.testing.assert_array_equal(whole, thinned)
