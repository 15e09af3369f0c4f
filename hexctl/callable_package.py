"""Callable packages: `hexctl.adapt(...)` is a function, `hexctl.adapt.space` one of its modules."""

import inspect
import sys
from importlib import import_module
from types import ModuleType
from typing import Any


def make_callable(package: str, module: str) -> None:
    """Let a call of a package import its module and call the function of the package's name in it."""
    name = package.rpartition(".")[2]

    class CallablePackage(ModuleType):
        @property
        def __call__(self) -> Any:
            return _function()

        @property
        def __signature__(self) -> inspect.Signature:
            return inspect.signature(_function())

    def _function() -> Any:
        return getattr(import_module(f"{package}.{module}"), name)

    sys.modules[package].__class__ = CallablePackage
