"""`random` and `exhaustive`: the baselines that a search must beat."""

from typing import Any

from hexctl.adapt.optimizer import Optimizer
from hexctl.adapt.space import GaitSpace


class RandomSearch(Optimizer):
    """All codes in random order without repetition; then a new shuffled round.

    The expected best rank after n draws from N codes is (N + 1)/(n + 1): 5.8 of 120 after 20 draws.
    """

    name = "random"

    def __init__(self, space: GaitSpace, seed: int) -> None:
        super().__init__(space, seed)
        self._order = self._shuffled()
        self._done = 0

    def _suggest(self, count: int) -> list[int]:
        return self._order[self._done : self._done + count]

    def _learn(self, codes: list[int], scores: list[float]) -> None:
        self._done += len(codes)
        if self._done == self.space.size:
            self._order, self._done = self._shuffled(), 0

    def _shuffled(self) -> list[int]:
        return [int(code) for code in 1 + self._random.permutation(self.space.size)]

    def _search_state(self) -> dict[str, Any]:
        return {"order": list(self._order), "done": self._done}

    def _restore_search(self, state: dict[str, Any]) -> None:
        self._order, self._done = [int(code) for code in state["order"]], int(state["done"])


class ExhaustiveSearch(Optimizer):
    """Codes 1..n in order, then again from 1; the seed has no effect."""

    name = "exhaustive"

    def __init__(self, space: GaitSpace, seed: int) -> None:
        super().__init__(space, seed)
        self._done = 0

    def _suggest(self, count: int) -> list[int]:
        return list(range(self._done + 1, min(self._done + count, self.space.size) + 1))

    def _learn(self, codes: list[int], scores: list[float]) -> None:
        self._done = (self._done + len(codes)) % self.space.size

    def _search_state(self) -> dict[str, Any]:
        return {"done": self._done}

    def _restore_search(self, state: dict[str, Any]) -> None:
        self._done = int(state["done"])
