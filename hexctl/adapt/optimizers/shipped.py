"""The optimizers that come with hexctl, by name: light to import, for the Tab key."""

from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hexctl.adapt.optimizer import Optimizer


class _Shipped(Mapping[str, "type[Optimizer]"]):
    """Classes by name, each imported when it is asked for: the names alone load nothing."""

    def __init__(self, **addresses: str) -> None:
        self._addresses = addresses

    def __getitem__(self, name: str) -> "type[Optimizer]":
        module, _, kind = self._addresses[name].partition(":")
        found: type[Optimizer] = getattr(import_module(f"{__package__}.{module}"), kind)
        return found

    def __iter__(self) -> Iterator[str]:
        return iter(self._addresses)

    def __len__(self) -> int:
        return len(self._addresses)


#: The optimizers that come with hexctl and need no prior, by name.
OPTIMIZERS: "Mapping[str, type[Optimizer]]" = _Shipped(
    pso="population:Pso",
    psosp="population:Psosp",
    dps="population:Dps",
    debest="population:DeBest",
    derand="population:DeRand",
    random="baselines:RandomSearch",
    exhaustive="baselines:ExhaustiveSearch",
)

#: Needs a prior, so that `hexctl.adapt.sessions.session_optimizer` makes it.
BAYES = "bayes"

#: Walks the strides that the servos of a robot hold, so that it is made there too.
STRIDES = "strides"

#: Needs walks that hold their heading and a robot whose gaits are ranked, so that it is made there too.
TRIM = "trim"

#: Names of all optimizers that come with hexctl.
NAMES = (BAYES, STRIDES, TRIM, *OPTIMIZERS)
