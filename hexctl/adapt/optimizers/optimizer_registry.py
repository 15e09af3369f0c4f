"""The registry of optimizers."""

from collections.abc import Callable

from hexctl.adapt.optimizer import Optimizer, OptimizerChoice, OptimizerClass
from hexctl.adapt.optimizers.shipped import BAYES, NAMES, OPTIMIZERS, STRIDES, TRIM
from hexctl.adapt.space import GaitSpace
from hexctl.errors import InputError, argument, check_type
from hexctl.robot.plugins import load_named
from hexctl.typed_names import nearest

_CLASSES = {
    "hexctl.adapt.optimizers.bayes:Bayes": BAYES,
    "hexctl.adapt.optimizers.trim:TrimSearch": TRIM,
    "hexctl.adapt.optimizers.strides:StrideSearch": STRIDES,
}


def name_of(optimizer: OptimizerChoice) -> str:
    """Name of an optimizer in sessions."""
    if isinstance(optimizer, str):
        return optimizer
    if not (isinstance(optimizer, type) and issubclass(optimizer, Optimizer)):
        raise InputError(
            f"{argument('optimizer')}: got {optimizer!r}; allowed: a name, or a subclass of Optimizer"
        )
    address = f"{optimizer.__module__}:{optimizer.__qualname__}"
    if address in _CLASSES:
        return _CLASSES[address]
    shipped = OPTIMIZERS.get(getattr(optimizer, "name", ""))
    return optimizer.name if shipped is optimizer else address


def make_optimizer(name: OptimizerChoice | OptimizerClass, space: GaitSpace, seed: int) -> Optimizer:
    """Fresh optimizer of a name in `OPTIMIZERS`, of `package.module:Class`, or of a class.

    Raises InputError for an unknown name, with the known ones.
    """
    allowed = f"{BAYES} (with a prior), {', '.join(OPTIMIZERS)}, or an Optimizer class"
    check_type(name, (str, Callable), "optimizer", allowed)  # type: ignore[arg-type]
    if not isinstance(name, str):
        return name(space, seed)
    if name in OPTIMIZERS:
        return OPTIMIZERS[name](space, seed)
    if name == BAYES:
        raise InputError(
            f"{argument('optimizer')}: got {BAYES} without a prior; allowed: {', '.join(OPTIMIZERS)} "
            f"({BAYES} with hexctl adapt and hexctl study --transfer)"
        )
    if name in (TRIM, STRIDES):
        raise InputError(
            f"{argument('optimizer')}: got {name} outside of a session; allowed: {', '.join(OPTIMIZERS)} "
            f"({name} with hexctl adapt)"
        )
    if ":" in name:
        return _own(name)(space, seed)
    raise InputError(
        f"{argument('optimizer')}: got {name!r}; allowed: {BAYES} (with a prior), {', '.join(OPTIMIZERS)}, "
        f"{TRIM} and {STRIDES} (with hexctl adapt), "
        f"or package.module:Class for your own Optimizer{nearest(name, NAMES)}"
    )


def _own(name: str) -> type[Optimizer]:
    try:
        found = load_named(name, "optimizer")
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(
            f"{argument('optimizer')}: {name!r} cannot be loaded ({error}); allowed: an Optimizer class "
            "in a file that can be imported"
        ) from error
    if not (isinstance(found, type) and issubclass(found, Optimizer)):
        raise InputError(f"{argument('optimizer')}: {name!r} is {found!r}; allowed: a subclass of Optimizer")
    return found
