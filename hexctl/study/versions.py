"""Versions of the code that simulates landscapes; landscapes of different code are never mixed."""

import ast
import hashlib
from collections.abc import Iterator
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_PACKAGES = ("hexctl", "mujoco", "dm_control", "numpy")

#: The module whose imports, direct and indirect, decide how a gait walks in a landscape.
ENTRY = "hexctl.study.landscape"

#: Modules whose imports are not followed: they decide no number.
_ASIDE = ("hexctl", "hexctl.errors", "hexctl.study.versions")

#: The folder that holds the package.
ROOT = Path(__file__).resolve().parents[2]


@cache
def code_versions() -> dict[str, str]:
    """Versions of the packages that a landscape depends on, and a digest of the source that simulates it.

    Read once per process: files are assumed to be the imported ones.
    """
    installed = {package: _version(package) for package in _PACKAGES}
    return {**installed, "source": source_digest()}


def source_digest(entry: str = ENTRY, root: Path = ROOT) -> str:
    """Digest of the names and the code of `simulating_sources`."""
    digest = hashlib.sha256()
    for file, code in sorted(simulating_sources(entry, root).items()):
        digest.update(file.relative_to(root).as_posix().encode())
        digest.update(code.encode())
    return digest.hexdigest()[:16]


def simulating_sources(entry: str = ENTRY, root: Path = ROOT) -> dict[Path, str]:
    """Code of the files of hexctl that simulate a landscape: a module and everything that it imports.

    Imports inside functions count, imports for type checkers do not.
    """
    codes: dict[Path, str] = {}
    modules, seen = [entry], {*_ASIDE}
    while modules:
        module = modules.pop()
        file = None if module in seen else _file_of(module, root)
        seen.add(module)
        if file is not None:
            imported, codes[file] = _read(file.read_bytes())
            modules += imported
    return codes


@cache
def _read(source: bytes) -> tuple[list[str], str]:
    """Imports of a module, and its code without comments and docstrings, those of fields included."""
    tree = ast.parse(source)
    imported = list(_imported(tree))
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            vars(node)["body"] = [one for one in body if not _is_text(one)]
    return imported, ast.unparse(tree)


def _is_text(statement: ast.stmt) -> bool:
    return (
        isinstance(statement, ast.Expr)
        and isinstance(statement.value, ast.Constant)
        and isinstance(statement.value.value, str)
    )


def _file_of(module: str, root: Path) -> Path | None:
    path = root.joinpath(*module.split("."))
    files = (path.with_suffix(".py"), path / "__init__.py")
    return next((file for file in files if file.is_file()), None)


def _imported(tree: ast.AST) -> Iterator[str]:
    """Names that a module imports from hexctl: modules, and objects that may be modules."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "hexctl":
            yield str(node.module)
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name.partition(".")[0] == "hexctl")
        elif not (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"):
            yield from _imported(node)


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "none"
