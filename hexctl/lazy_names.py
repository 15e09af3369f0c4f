"""Packages whose names are imported when first used, and that are callable: for a fast import."""

import sys
from collections.abc import Callable, Sequence
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any


def lazy_names(package: str, file: str, names: Sequence[str]) -> Callable[[str], Any]:
    """`__getattr__` of a package's names, each from the module that its block `if TYPE_CHECKING` has."""

    @cache
    def module_of() -> dict[str, str]:
        import ast

        body = ast.parse(Path(file).read_text(encoding="utf-8")).body
        blocks = (node for node in body if isinstance(node, ast.If))
        block = next(node for node in blocks if ast.unparse(node.test) == "TYPE_CHECKING")
        imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
        return {alias.name: str(node.module) for node in imports for alias in node.names}

    def load(name: str) -> Any:
        if name not in names:
            raise AttributeError(f"module {package!r} has no attribute {name!r}; it has {', '.join(names)}")
        try:
            return getattr(import_module(module_of()[name]), name)
        except ModuleNotFoundError as error:
            from hexctl.errors import EXTRAS, MissingExtraError

            extra = EXTRAS.get((error.name or "").partition(".")[0])
            if extra is None:
                raise
            raise MissingExtraError(f"{package}.{name}", extra) from error

    return load


def make_callable(package: str, module: str) -> None:
    """Let a call of a package call the function of its name in a module: `hexctl.adapt(...)`."""
    name = package.rpartition(".")[2]

    class CallablePackage(ModuleType):
        @property
        def __call__(self) -> Any:
            return _function()

        @property
        def __signature__(self) -> Any:
            import inspect

            return inspect.signature(_function())

    def _function() -> Any:
        return getattr(import_module(f"{package}.{module}"), name)

    sys.modules[package].__class__ = CallablePackage
