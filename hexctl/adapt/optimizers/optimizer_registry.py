"""The registry of optimizers."""

from importlib import import_module

from hexctl.adapt.optimizer import Optimizer, OptimizerChoice, OptimizerClass
from hexctl.adapt.optimizers.shipped import BAYES, NAMES, OF_SESSIONS, OPTIMIZERS
from hexctl.adapt.space import GaitSpace
from hexctl.errors import InputError, argument, check_type
from hexctl.robot.plugins import label_of, load_custom, made_by


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


def make_optimizer(
    name: OptimizerChoice | OptimizerClass, space: GaitSpace, seed: int, *, part: str = "optimizer"
) -> Optimizer:
    """Fresh optimizer of a name in `OPTIMIZERS`, of `package.module:Class`, or of a class.

    Messages call the argument `part`. Raises InputError for an unknown name, with the known ones, and for a
    custom class that cannot be made.
    """
    allowed, known, named = "a subclass of Optimizer", ", ".join(OPTIMIZERS), argument(part)
    if callable(name):
        made, label = name, label_of(name if isinstance(name, type) else type(name))
    else:
        check_type(name, str, part, f"{BAYES} (with a prior), {known}, or an Optimizer class")
        if name in OF_SESSIONS:
            commands = "hexctl adapt and hexctl study --transfer" if name == BAYES else "hexctl adapt"
            raise InputError(
                f"{named}: got {name} outside of a session; allowed: {known} ({name} with {commands})"
            )
        if name in OPTIMIZERS:
            module, _, kind = OPTIMIZERS[name].partition(":")
            shipped: Optimizer = getattr(import_module(f"{__package__}.{module}"), kind)(space, seed)
            return shipped
        made, label = load_custom(name, part, known=NAMES, allowed=allowed, door="optimizers")
        if not _is_optimizer(made):
            raise InputError(f"{named}: {label} is {made!r}; allowed: {allowed}")
    optimizer = made_by(lambda: made(space, seed), label, Optimizer, part, allowed)  # type: ignore[type-abstract]
    if not isinstance(getattr(optimizer, "name", None), str):
        raise InputError(f"{named}: {label} has no name; allowed: {allowed} with a text `name`")
    optimizer.state()  # raises an error here, not after the first walks
    return optimizer


def _is_optimizer(value: object) -> bool:
    return isinstance(value, type) and issubclass(value, Optimizer)
