"""The registry of optimizers: from a name to an optimizer."""

from hexctl.adapt.baselines import ExhaustiveSearch, RandomSearch
from hexctl.adapt.differential_evolution import DeBest, DeRand
from hexctl.adapt.optimizer import Optimizer
from hexctl.adapt.space import GaitSpace
from hexctl.adapt.swarm import Dps, Pso, Psosp
from hexctl.errors import InputError
from hexctl.robot.plugins import module_here

OPTIMIZERS: dict[str, type[Optimizer]] = {
    "pso": Pso,
    "psosp": Psosp,
    "dps": Dps,
    "debest": DeBest,
    "derand": DeRand,
    "random": RandomSearch,
    "exhaustive": ExhaustiveSearch,
}

#: Needs a prior, and is therefore made by `hexctl.adapt.search`.
BAYES = "bayes"


def make_optimizer(name: str, space: GaitSpace, seed: int) -> Optimizer:
    """Return a fresh optimizer.

    `name` is one of `OPTIMIZERS`, or `package.module:Class` for an Optimizer of your own. Raises InputError
    for an unknown name, with the known ones.
    """
    if name in OPTIMIZERS:
        return OPTIMIZERS[name](space, seed)
    if name == BAYES:
        raise InputError(
            f"optimizer: got {BAYES} without a prior; allowed: {', '.join(OPTIMIZERS)} "
            f"({BAYES} with hexctl adapt and hexctl study --transfer)"
        )
    if ":" in name:
        return _own(name)(space, seed)
    raise InputError(
        f"optimizer: got {name!r}; allowed: {BAYES} (with a prior), {', '.join(OPTIMIZERS)}, "
        "or package.module:Class for your own Optimizer"
    )


def _own(name: str) -> type[Optimizer]:
    module_name, _, class_name = name.partition(":")
    try:
        found = getattr(module_here(module_name), class_name)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(
            f"optimizer: {name!r} cannot be loaded ({error}); allowed: an Optimizer class"
        ) from error
    if not (isinstance(found, type) and issubclass(found, Optimizer)):
        raise InputError(f"optimizer: {name!r} is {found!r}; allowed: a subclass of Optimizer")
    return found
