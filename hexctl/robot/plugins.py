"""Classes and functions of the user, named as `package.module:name`: servos, optimizers, objectives."""

import importlib
import os
import sys
from types import ModuleType
from typing import Any


def module_here(name: str) -> ModuleType:
    """Module of a dotted name; one in the working folder is found, as with `python -m`.

    Raises the errors of the import.
    """
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    return importlib.import_module(name)


def load_named(name: str, part: str) -> Any:
    """What `package.module:name` names.

    Args:
        name: module and attribute.
        part: the argument of `hexctl.Adaptation` that takes such a thing as it is, for the message.

    Raises the errors of the import, AttributeError for an attribute that the module lacks, ImportError for
    one of a script that is not running, which is how a session stores what the script itself has defined.
    """
    module_name, _, attribute = name.partition(":")
    module = module_here(module_name)
    if module_name == "__main__" and not hasattr(module, attribute):
        raise ImportError(
            f"it is of the script that began the session, to be continued from Python: "
            f"hexctl.Adaptation.resume(NAME, {part}={attribute}).run()"
        )
    return getattr(module, attribute)
