"""Spaces, landscapes and a search loop for tests of optimizers."""

from collections.abc import Callable

from hexctl.adapt.optimizer import Optimizer
from hexctl.adapt.space import GaitSpace

ONE_FAILED, TWO_FAILED, THREE_FAILED = GaitSpace((5,)), GaitSpace((2, 5)), GaitSpace((1, 3, 5))

Landscape = Callable[[int], float]


def slope(code: int) -> float:
    """A smooth landscape whose best code is 77."""
    return abs(code - 77.3)


def search(
    optimizer: Optimizer, trials: int, *, batch: int = 1, landscape: Landscape = slope, told: bool = True
) -> list[int]:
    """Ask for `trials` codes in batches and tell their scores; return the codes.

    Ends early when the optimizer is exhausted. With `told` False the last batch is not told.
    """
    codes: list[int] = []
    while len(codes) < trials and not optimizer.exhausted:
        asked = optimizer.ask(min(batch, trials - len(codes)))
        codes += asked
        if told or len(codes) < trials:
            optimizer.tell(asked, [landscape(code) for code in asked])
    return codes
