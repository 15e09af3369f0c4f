"""All optimizers, with and without deduplication, keep to the interface; the baselines and the registry."""

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.adapt.optimizer import Optimizer
from hexctl.adapt.optimizers.deduplication import Deduplication
from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.optimizers.shipped import OPTIMIZERS
from hexctl.adapt.space import GaitSpace
from hexctl.errors import InputError
from hexctl.testing.optimizer_conformance import (
    BATCHES,
    ONE_FAILED,
    Make,
    OptimizerConformance,
    search,
)


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


@pytest.mark.parametrize("name", ["pso", "psosp", "dps", "debest", "derand"])
@pytest.mark.parametrize("best", [12, 77])
def test_searches_find_the_best_of_a_smooth_landscape_far_sooner_than_chance(name: str, best: int) -> None:
    # 60 of 120 codes contain the best one with probability 1/2: 27 or more of 30 have probability 4e-6.
    assert found_best(fresh(name), trials=60, best=best, seeds=30) >= 27 / 30


PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "extend.md"


@pytest.fixture
def nearby(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Make:
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    (program,) = [block for block in blocks if "class Nearby" in block]
    (tmp_path / "nearby.py").write_text(program, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "nearby", raising=False)
    return lambda space, seed: make_optimizer("nearby:Nearby", space, seed)


class TestNearby(OptimizerConformance):
    @pytest.fixture
    def make(self, nearby: Make) -> Make:
        return nearby


@pytest.mark.parametrize(
    "name", ["genetic", "nowhere:Thing", "math:nothing", ":", "math:", "math:pi", "pathlib:Path"]
)
def test_unknown_optimizers_are_refused(name: str) -> None:
    with pytest.raises(InputError, match="optimizer"):
        make_optimizer(name, ONE_FAILED, 0)


class Forgetful(Optimizer):
    """Learns nothing."""

    name = "forgetful"

    def _suggest(self, count: int) -> list[int]:
        return [1] * count

    def _search_state(self) -> dict[str, Any]:
        return {}

    def _restore_search(self, state: dict[str, Any]) -> None:
        pass


def test_an_optimizer_that_does_not_learn_is_refused_before_it_is_asked() -> None:
    with pytest.raises(InputError, match="_learn"):
        make_optimizer(Forgetful, ONE_FAILED, 0)
