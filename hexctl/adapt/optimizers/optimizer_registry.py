"""The registry of optimizers."""

from importlib import import_module

from hexctl.adapt.optimizer import Optimizer, OptimizerChoice, OptimizerClass
from hexctl.adapt.optimizers.shipped import BAYES, NAMES, OF_SESSIONS, OPTIMIZERS
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
    shipped = {f"{__package__}.{place}": name for name, place in (OF_SESSIONS | OPTIMIZERS).items()}
    return shipped.get(address, address)


def make_optimizer(name: OptimizerChoice | OptimizerClass, space: GaitSpace, seed: int) -> Optimizer:
    """Fresh optimizer of a name in `OPTIMIZERS`, of `package.module:Class`, or of a class.

    Raises InputError for an unknown name, with the known ones.
    """
    known = ", ".join(OPTIMIZERS)
    if callable(name):
        return name(space, seed)
    check_type(name, str, "optimizer", f"{BAYES} (with a prior), {known}, or an Optimizer class")
    if name in OF_SESSIONS:
        commands = "hexctl adapt and hexctl study --transfer" if name == BAYES else "hexctl adapt"
        raise InputError(
            f"{argument('optimizer')}: got {name} outside of a session; allowed: {known} "
            f"({name} with {commands})"
        )
    return _class_of(name)(space, seed)


def _class_of(name: str) -> type[Optimizer]:
    if name in OPTIMIZERS:
        module, _, kind = OPTIMIZERS[name].partition(":")
        shipped: type[Optimizer] = getattr(import_module(f"{__package__}.{module}"), kind)
        return shipped
    allowed = "a subclass of Optimizer"
    custom, label = load_custom(name, "optimizer", known=NAMES, allowed=allowed, door="optimizers")
    if not _is_optimizer(custom):
        raise InputError(f"{argument('optimizer')}: {label} is {custom!r}; allowed: {allowed}")
    found: type[Optimizer] = custom
    return found


def _is_optimizer(value: object) -> bool:
    return isinstance(value, type) and issubclass(value, Optimizer)
