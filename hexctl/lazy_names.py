"""Names of a package that are imported when they are first used, so that the package itself costs nothing."""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def lazy_names(package: str, modules: Mapping[str, str]) -> Callable[[str], Any]:
    """Function for `__getattr__` of a package; a missing extra and an unknown name are told.

    Args:
        package: name of the package, such as `hexctl.vision`.
        modules: names by the module that they live in, below the package, with blanks between them.
    """
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
