"""Modules of the user's own, named on the command line."""

import importlib
import os
import sys
from types import ModuleType


def module_here(name: str) -> ModuleType:
    """Return a module by its dotted name; one in the working folder is found, as with `python -m`.

    Raises what the import raises.
    """
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    return importlib.import_module(name)
