"""Lazy imports of a package's names, to keep the import of the package fast."""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def lazy_names(package: str, modules: Mapping[str, str]) -> Callable[[str], Any]:
    """`__getattr__` of a package, from names separated by blanks by their module."""
    module_of = {name: module for module, names in modules.items() for name in names.split()}

    def load(name: str) -> Any:
        if name not in module_of:
            known = ", ".join(module_of)
            raise AttributeError(f"module {package!r} has no attribute {name!r}; it has {known}")
        try:
            return getattr(import_module(f"{package}.{module_of[name]}"), name)
        except ModuleNotFoundError as error:
            from hexctl.errors import EXTRAS, MissingExtraError

            extra = EXTRAS.get((error.name or "").partition(".")[0])
            if extra is None:
                raise
            raise MissingExtraError(f"{package}.{name}", extra) from error

    return load
