"""Deduplication: every code is walked once, and the search inside is unaffected."""

from collections.abc import Callable, Iterator
from itertools import count, repeat
from typing import Any
from unittest import mock

import numpy as np
import pytest

from hexctl.adapt.optimizer import Observation, Optimizer
from hexctl.adapt.optimizers.deduplication import Deduplication, SpaceExhaustedError
from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.optimizers.shipped import OPTIMIZERS
from hexctl.errors import InputError
from hexctl.testing.optimizer_conformance import ONE_FAILED, search, slope


class Scripted(Optimizer):
    """Asks for the codes of a script and writes down what it is told."""

    name = "scripted"

    def __init__(self, script: Iterator[int]) -> None:
        super().__init__(ONE_FAILED, 0)
        self._script = script
        self.told: list[tuple[int, float]] = []

    def _suggest(self, count: int) -> list[int]:
        return [next(self._script) for _ in range(count)]

    def _learn(self, codes: list[int], scores: list[float]) -> None:
        self.told += zip(codes, scores, strict=True)

    def _search_state(self) -> dict[str, Any]:
        return {}

    def _restore_search(self, state: dict[str, Any]) -> None:
        pass


def fresh(name: str, seed: int = 1, **options: Any) -> Deduplication:
    return Deduplication(make_optimizer(name, ONE_FAILED, seed), seed, **options)


def tell(optimizer: Optimizer, codes: list[int]) -> None:
    optimizer.tell(codes, [slope(code) for code in codes])


@pytest.mark.parametrize("name", OPTIMIZERS)
@pytest.mark.parametrize(("batch", "landscape"), [(1, slope), (64, lambda _: 1e9)], ids=["slope", "flat"])
def test_every_code_is_handed_out_once_and_then_it_is_exhausted(
    name: str, batch: int, landscape: Callable[[int], float]
) -> None:
    optimizer = fresh(name)
    codes = search(optimizer, 1000, batch=batch, landscape=landscape)
    assert sorted(codes) == list(range(1, 121))
    assert optimizer.exhausted
    with pytest.raises(SpaceExhaustedError, match=name):
        optimizer.ask()


def test_a_search_that_is_stuck_gets_help_after_the_patience_and_asks_on() -> None:
    inner = Scripted(repeat(5))
    optimizer = Deduplication(inner, 0, patience=20)
    assert search(optimizer, 1) == [5]
    substitutes = optimizer.ask()
    assert len(inner.told) == 1 + 20
    tell(optimizer, substitutes)
    for extra in range(1, 30):
        tell(optimizer, optimizer.ask())
        assert len(inner.told) == 1 + 20 + extra
    assert set(inner.told) == {(5, slope(5))}, "a code that it did not ask for"


@pytest.mark.parametrize("stop", [0, 3])
def test_help_goes_on_after_a_restore(stop: int) -> None:
    # By then the swarm has collapsed.
    original, restored = fresh("pso", 5, patience=5), fresh("pso", 6, patience=5)
    search(original, 60 + stop)
    restored.restore(original.state())
    assert search(restored, 20) == search(original, 20)


SEEN = Observation(path_m=np.zeros((3, 2)), duration_s=1.0, yaw_change_rad=0.0, status="ok")

#: Calls that are passed to the search, with arguments.
CALLS: dict[str, tuple[Any, ...]] = {
    "recommended": (),
    "predict": (3,),
    "trim": (3,),
    "stride": (3,),
    "early_stopping": (3,),
    "repeat": (5, 0.5, SEEN),
}


@pytest.mark.parametrize("paper_count", [False, True])
def test_everything_that_the_search_says_passes_through(paper_count: bool) -> None:
    told = {"judges_target": True, "trims": True, "exhausted": True, "finished": True, "worthwhile": False}
    inner = mock.create_autospec(Scripted(count(1)), space=ONE_FAILED, **told)
    inner.name = "outspoken"
    optimizer = Deduplication(inner, 0, paper_count=paper_count)
    for name, arguments in CALLS.items():
        given = getattr(optimizer, name)(*arguments)
        getattr(inner, name).assert_called_once_with(*arguments)
        assert name == "repeat" or given is getattr(inner, name).return_value
    inner.ask.return_value = [1, 2]
    optimizer.tell(optimizer.ask(2), [0.1, 0.2], [SEEN, None])
    inner.tell.assert_called_once_with([1, 2], [0.1, 0.2], [SEEN, None])
    fields = ("space", "name", *told)
    assert [getattr(optimizer, name) for name in fields] == [getattr(inner, name) for name in fields]
    public = {name for name in {*vars(Optimizer), *Optimizer.__annotations__} if not name.startswith("_")}
    assert public | {"space"} == {*fields, *CALLS, "ask", "tell", "state", "restore"}, "is it passed through?"


@pytest.mark.parametrize("options", [{"paper_count": True}, {"patience": 7}, None], ids=str)
def test_states_of_other_rules_and_of_bare_searches_are_refused(options: dict[str, Any] | None) -> None:
    optimizer, bare = fresh("pso"), make_optimizer("pso", ONE_FAILED, 0)
    before = optimizer.state()
    with pytest.raises(InputError):
        optimizer.restore(bare.state() if options is None else fresh("pso", **options).state())
    assert optimizer.state() == before
    with pytest.raises(InputError):
        bare.restore(before)
