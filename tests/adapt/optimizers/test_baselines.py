"""The baselines: random without repetition, and all codes in order."""

import numpy as np
import pytest

from hexctl.adapt.optimizers.baselines import ExhaustiveSearch, RandomSearch
from hexctl.adapt.space import GaitSpace
from hexctl.testing.optimizer_conformance import ONE_FAILED, THREE_FAILED, TWO_FAILED, search

ALL = {space.size: list(range(1, space.size + 1)) for space in (ONE_FAILED, TWO_FAILED, THREE_FAILED)}


@pytest.mark.parametrize("space", [ONE_FAILED, TWO_FAILED, THREE_FAILED], ids=lambda space: space.size)
@pytest.mark.parametrize("batch", [1, 7, 64])
def test_random_goes_through_all_codes_in_another_order_each_round(space: GaitSpace, batch: int) -> None:
    codes = search(RandomSearch(space, 5), 3 * space.size, batch=batch)
    rounds = [codes[start : start + space.size] for start in range(0, len(codes), space.size)]
    assert [sorted(one) for one in rounds] == [ALL[space.size]] * 3
    assert rounds[0] != rounds[1] != rounds[2]


@pytest.mark.parametrize("draws", [1, 5, 20, 60])
def test_the_best_rank_of_n_random_draws_is_121_over_n_plus_1(draws: int) -> None:
    best = [min(search(RandomSearch(ONE_FAILED, seed), draws, batch=draws)) for seed in range(2000)]
    # Four standard errors of the mean: a right implementation fails for one in 16 000 sets of seeds.
    tolerance = 4 * np.std(best) / np.sqrt(len(best))
    assert np.mean(best) == pytest.approx(121 / (draws + 1), abs=tolerance)


def test_random_gives_every_code_the_same_chance_to_be_first() -> None:
    first = np.bincount([RandomSearch(THREE_FAILED, seed).ask()[0] for seed in range(6000)])[1:]
    # 1000 each; the standard deviation is 29.
    assert first.sum() == 6000
    assert np.abs(first - 1000).max() < 4 * 29


@pytest.mark.parametrize("batch", [1, 7, 64])
def test_exhaustive_counts_up_and_starts_again(batch: int) -> None:
    assert search(ExhaustiveSearch(TWO_FAILED, 0), 60, batch=batch) == [*ALL[24], *ALL[24], *ALL[24][:12]]
