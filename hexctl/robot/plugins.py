"""Custom classes and functions, named as `package.module:name`: servos, optimizers, objectives."""

import importlib
import os
import sys
from collections.abc import Callable, Mapping
from inspect import isclass
from types import ModuleType
from typing import Any, TypeVar

from hexctl.errors import InputError, argument
from hexctl.typed_names import nearest

MadeT = TypeVar("MadeT")


def module_here(name: str) -> ModuleType:
    """Module of a dotted name, also in the working folder; raises the errors of the import.

    Libraries come first: a `rerun.py` in the folder must not replace Rerun.
    """
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    return importlib.import_module(name)


def load_named(name: str, part: str) -> Any:
    """The object that `package.module:name` names; `part` is its argument of `hexctl.Adaptation`.

    Raises the errors of the import, AttributeError for a missing attribute, ImportError for an attribute of a
    script other than the running one. A session stores objects of the running script this way.
    """
    module_name, _, attribute = name.partition(":")
    module = module_here(module_name)
    if module_name == "__main__" and not hasattr(module, attribute):
        raise ImportError(
            f"it is of the script that began the session, to be continued from Python: "
            f"hexctl.Adaptation.resume(NAME, {part}={attribute}).run()"
        )
    return getattr(module, attribute)


def made_of(name: str, named: Mapping[str, Callable[[], MadeT]], kind: type[MadeT], part: str) -> MadeT:
    """An object of a name in `named`, or of `package.module:Class`, of a kind; raises InputError."""
    if name in named:
        return named[name]()
    what, allowed = argument(part), f"{', '.join(named)}, package.module:Class"
    if ":" not in name:
        raise InputError(f"{what}: got {name or repr(name)}; allowed: {allowed}{nearest(name, named)}")
    try:
        own = load_named(name, part)
        made = own() if isclass(own) else own
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise InputError(f"{what}: {name} cannot be loaded ({error}); allowed: {allowed}") from error
    if not isinstance(made, kind):
        raise InputError(f"{what}: got {name}, a {type(made).__name__}; allowed: a {kind.__name__}")
    return made
