"""The registry of optimizers."""

from hexctl.adapt.optimizer import Optimizer, OptimizerChoice, OptimizerClass
from hexctl.adapt.optimizers import baselines, population
from hexctl.adapt.optimizers.shipped import (
    BASELINES,
    BAYES,
    NAMES,
    OF_SESSIONS,
    OPTIMIZERS,
    POPULATIONS,
)
from hexctl.adapt.space import GaitSpace
from hexctl.errors import InputError, argument, check_type
from hexctl.robot.plugins import load_custom


def name_of(optimizer: OptimizerChoice) -> str:
    """Name of an optimizer in sessions."""
    if isinstance(optimizer, str):
        return optimizer
    if not _is_optimizer(optimizer):
        raise InputError(
            f"{argument('optimizer')}: got {optimizer!r}; allowed: a name, or a subclass of Optimizer"
        )
    address = f"{optimizer.__module__}:{optimizer.__qualname__}"
    places = OF_SESSIONS | {name: f"baselines:{kind}" for name, kind in BASELINES.items()}
    shipped = {f"{__package__}.{place}": name for name, place in places.items()}
    return shipped.get(address, address)


def make_optimizer(name: OptimizerChoice | OptimizerClass, space: GaitSpace, seed: int) -> Optimizer:
    """Fresh optimizer of a name in `OPTIMIZERS`, of `package.module:Class`, or of a class.

    Raises InputError for an unknown name, with the known ones.
    """
    known = ", ".join(OPTIMIZERS)
    if callable(name):
        return name(space, seed)
    check_type(name, str, "optimizer", f"{BAYES} (with a prior), {known}, or an Optimizer class")
    if name in POPULATIONS:
        return population.PopulationOptimizer(name, getattr(population, POPULATIONS[name]), space, seed)
    if name in BASELINES:
        baseline: type[Optimizer] = getattr(baselines, BASELINES[name])
        return baseline(space, seed)
    if name in OF_SESSIONS:
        commands = "hexctl adapt and hexctl study --transfer" if name == BAYES else "hexctl adapt"
        raise InputError(
            f"{argument('optimizer')}: got {name} outside of a session; allowed: {known} "
            f"({name} with {commands})"
        )
    kind, label = load_custom(
        name, "optimizer", known=NAMES, allowed="a subclass of Optimizer", door="optimizers"
    )
    if not _is_optimizer(kind):
        raise InputError(f"{argument('optimizer')}: {label} is {kind!r}; allowed: a subclass of Optimizer")
    custom: type[Optimizer] = kind
    return custom(space, seed)


def _is_optimizer(value: object) -> bool:
    return isinstance(value, type) and issubclass(value, Optimizer)
