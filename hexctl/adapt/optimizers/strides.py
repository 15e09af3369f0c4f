"""`strides`: searches pace, amplitude and swing share of steered walks, then codes.

The gaits of `fast_gaits` walk one after the other, the fastest first, because weak servos, slip and sag make
another one the best. The best one walks more slowly, too. Then the best stride walks with other codes, the
most stable first.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from hexctl.adapt.optimizer import Optimizer
from hexctl.adapt.space import GaitSpace
from hexctl.control.planning.top_speed import Stride
from hexctl.gait.encoding import Slots
from hexctl.gait.gait import Gait

#: Share of the pace that the servos hold at which the best gait walks again.
SLOWER = 0.8


class StrideSearch(Optimizer):
    """Walks a table of strides, then codes with the best of them.

    Args:
        gaits: of the table, each at the pace that the servos hold; without any, only codes walk.
        ranked: slots of all gaits in the order in which they walk last; None is ascending codes.
    """

    name = "strides"

    def __init__(
        self,
        space: GaitSpace,
        seed: int,
        *,
        gaits: Sequence[Gait] = (),
        ranked: Sequence[Slots] | None = None,
    ) -> None:
        super().__init__(space, seed)
        self._gaits = [(space.code_of(gait.slots), Stride.of(gait)) for gait in gaits]
        slots = [space.slots_of(code) for code in range(1, space.size + 1)] if ranked is None else ranked
        self._codes = [space.code_of(one) for one in slots]
        #: Code, row of the table or -1, and score of each walk.
        self._walks: list[tuple[int, int, float]] = []

    @property
    def exhausted(self) -> bool:
        """True when the table and all codes have been walked."""
        return self._next() is None

    def stride(self, code: int) -> Stride | None:
        """Stride of the next walk of a gait: the one in turn, else the best one that it has walked."""
        turn = self._next()
        if self._asked is not None and turn is not None and turn[0] == code:
            row = turn[1]
        else:
            row = _best([walk for walk in self._walks if walk[0] == code])[1]
        return None if row < 0 else self._table[row][1]

    @property
    def _table(self) -> list[tuple[int, Stride]]:
        """Code and stride of the rows: the given gaits, and once all have walked the best one, slower."""
        walks = self._walks[: len(self._gaits)]
        if not walks or len(walks) < len(self._gaits):
            return self._gaits
        code, stride = self._gaits[_best(walks)[1]]
        return [*self._gaits, (code, replace(stride, pace_hz=round(SLOWER * stride.pace_hz, 3)))]

    def _next(self) -> tuple[int, int] | None:
        """Code and row of the next walk; None if there is none."""
        if len(self._walks) < len(self._table):
            row = len(self._walks)
            return self._table[row][0], row
        row = _best(self._walks)[1] if self._gaits else -1
        walked = {self._shape(code, row) for code, other, _ in self._walks if other == row}
        return next(((code, row) for code in self._codes if self._shape(code, row) not in walked), None)

    def _shape(self, code: int, row: int) -> object:
        """What distinguishes a gait: its code, or with evenly spread swings the order of its legs."""
        if row < 0 or not self._table[row][1].spread:
            return code
        return tuple(Stride.order(self.space.slots_of(code), self.space.failed_legs))

    def _suggest(self, count: int) -> list[int]:
        turn = self._next()
        return [self._codes[0] if turn is None else turn[0]]

    def _learn(self, codes: list[int], scores: list[float]) -> None:
        turn = self._next()
        row = -1 if turn is None else turn[1]
        self._walks += [(code, row, score) for code, score in zip(codes, scores, strict=True)]

    def _search_state(self) -> dict[str, Any]:
        return {"walks": [list(walk) for walk in self._walks]}

    def _restore_search(self, state: dict[str, Any]) -> None:
        walks = [(int(code), int(row), float(score)) for code, row, score in state["walks"]]
        if not all(1 <= code <= self.space.size and -1 <= row <= len(self._gaits) for code, row, _ in walks):
            raise ValueError("a walk of another table")
        self._walks = walks


def _best(walks: Sequence[tuple[int, int, float]]) -> tuple[int, int, float]:
    return min(walks, key=lambda walk: walk[2])
