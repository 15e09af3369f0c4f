"""Modules of the user, named on the command line: servos, optimizers."""

import importlib
import os
import sys
from types import ModuleType


def module_here(name: str) -> ModuleType:
    """Module of a dotted name; one in the working folder is found, as with `python -m`.

    Raises the errors of the import.
    """
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    return importlib.import_module(name)
