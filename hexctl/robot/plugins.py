"""Plug-ins of installed distributions, and custom objects named as `package.module:name`.

A distribution offers an object by an entry point in a group such as `hexctl.optimizers`. Names are read from
metadata; the object is imported when it is used.
"""

import os
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass
from functools import cache, partial
from importlib import import_module
from pkgutil import resolve_name
from traceback import print_exception, walk_tb
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from hexctl.errors import EXTRAS, HexctlError, InputError, MissingExtraError, argument, check_type, shown
from hexctl.typed_names import nearest

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

MadeT = TypeVar("MadeT")

#: What plug-ins may be: the last word of a group of entry points.
Door = Literal["servos", "families", "boards", "optimizers", "recoveries", "commands", "arenas"]

#: Variable that shows the tracebacks of errors that become one line.
DEBUG = "HEXCTL_DEBUG"

#: Top packages of custom objects so far, with their distributions; empty for a module that none offers.
_CUSTOM: dict[str, str] = {}


@dataclass(frozen=True, slots=True)
class Plugin:
    """An entry point of a distribution; nothing of it is imported before `load`."""

    door: Door
    entry: "EntryPoint"

    def __str__(self) -> str:
        return f"{self.entry.name} of {self.distribution}"

    @property
    def distribution(self) -> str:
        """Name and version of the distribution."""
        return f"{self.entry.dist.name} {self.entry.dist.version}" if self.entry.dist else "no distribution"

    @property
    def is_own(self) -> bool:
        """Whether hexctl itself offers it."""
        return self.entry.dist is not None and self.entry.dist.name == "hexctl"

    @property
    def summary(self) -> str:
        """Summary of the distribution, with object and distribution, for a list of commands."""
        metadata = self.entry.dist.metadata.json if self.entry.dist else {}
        return f"{str(metadata.get('summary', '')).rstrip('.')} ({self.entry.value} of {self.distribution})."

    def load(self) -> Any:
        """Import the object; raises InputError that names the distribution, or MissingExtraError."""
        if not self.is_own:
            _CUSTOM[_top(self.entry.module)] = self.distribution
        return _imported(self.entry.load, str(self), "repair or uninstall it")


def _top(module: str) -> str:
    return module.partition(".")[0]


def _imported(load: Callable[[], Any], label: str, step: str) -> Any:
    try:
        with redirect_stdout(sys.stderr):  # what an import prints is no output of a command
            return load()
    except (Exception, SystemExit) as error:
        if (extra := _missing_extra(error)) is not None:
            raise MissingExtraError(label, extra) from error
        raise InputError(f"{label} cannot be loaded ({why(error)}); {step}") from error


def _missing_extra(error: BaseException) -> str | None:
    return EXTRAS.get(_top(error.name or "")) if isinstance(error, ModuleNotFoundError) else None


def _debugs() -> bool:
    return os.environ.get(DEBUG, "0") not in ("", "0")


def why(error: BaseException) -> str:
    """Kind and text of an error of custom code, and how to see its traceback."""
    kind = "" if isinstance(error, HexctlError) else f"{type(error).__name__}: "
    return f"{kind}{error}".removesuffix(": ") + ("" if _debugs() else f"; {DEBUG}=1 shows where")


def show_traceback(error: BaseException) -> None:
    """Print the traceback of an error that becomes one line, if `HEXCTL_DEBUG` is set."""
    if _debugs():
        print_exception(error)


def label_of(kind: type) -> str:
    """Name of a class for messages, with module and distribution if it is custom."""
    return _label(kind.__module__, kind.__qualname__) or kind.__qualname__


def _label(module: str, name: str) -> str | None:
    distribution = _CUSTOM.get(_top(module))
    of = f" of {distribution}" if distribution else ""
    return None if distribution is None else f"{module}:{name}{of}"


def custom_failure(error: Exception) -> str | None:
    """Text of an unexpected error of custom code, which names the innermost function; None for others."""
    if _missing_extra(error) is not None:
        return None
    for frame, _ in reversed([*walk_tb(error.__traceback__)]):
        code, kind = frame.f_code, type(frame.f_locals.get("self"))
        label = _label(str(frame.f_globals.get("__name__")), code.co_qualname)
        label = label or _label(kind.__module__, f"{kind.__qualname__}.{code.co_name}")
        if label is not None:
            return f"{label} failed ({why(error)})"
    return None


@cache
def plugins(door: Door) -> tuple[Plugin, ...]:
    """All plug-ins of a door, hexctl's own first, then by name and distribution."""
    from importlib.metadata import entry_points  # slow to import

    found = [Plugin(door, entry) for entry in entry_points(group=f"hexctl.{door}")]
    return tuple(sorted(found, key=lambda one: (not one.is_own, one.entry.name, one.distribution)))


def plugin_names(door: Door) -> tuple[str, ...]:
    """Names of the plug-ins of a door."""
    return tuple(dict.fromkeys(one.entry.name for one in plugins(door)))


def find_plugin(door: Door, name: str) -> Plugin | None:
    """The plug-in of a name, or None; hexctl's own precedes others.

    Raises InputError if several distributions offer the name.
    """
    found = [one for one in plugins(door) if one.entry.name == name]
    if len(found) > 1 and not found[0].is_own:
        offering = " and ".join(one.distribution for one in found)
        raise InputError(f"{len(found)} distributions offer {name!r}: {offering}; uninstall all but one")
    return next(iter(found), None)


def find_named(door: Door, name: str, own: Mapping[str, str], kind: type[MadeT], named: str) -> MadeT:
    """The object of a name, which it has as `name`: hexctl's own of `module:name`, else a plug-in's.

    Messages begin with `named`. Raises InputError for an unknown name, and for a plug-in without such an
    object.
    """
    if name in own:
        found: MadeT = resolve_name(own[name])
        return found
    plugin = find_plugin(door, name)
    if plugin is None:
        known = tuple(dict.fromkeys((*own, *plugin_names(door))))
        raise InputError(f"{named}: got {name!r}; allowed: {', '.join(known)}{nearest(name, known)}")
    loaded = plugin.load()
    if not isinstance(loaded, kind) or getattr(loaded, "name", None) != name:
        got = f"one named {loaded.name!r}" if isinstance(loaded, kind) else shown(loaded)  # type: ignore[attr-defined]
        raise InputError(f"{named}: {plugin}: got {got}; allowed: a {kind.__name__} named {name!r}")
    return loaded


def module_here(name: str) -> ModuleType:
    """Module of a dotted name, also in the working folder; raises the errors of the import.

    Libraries come first: a `rerun.py` in the folder must not replace Rerun.
    """
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    return import_module(name)


def load_named(name: str, part: str) -> Any:
    """The object that `package.module:name` names; `part` is its argument of `hexctl.Adaptation`.

    Raises the errors of the import, AttributeError for a missing attribute, ImportError for an attribute of a
    script other than the running one. A session stores objects of the running script this way.
    """
    module_name, _, attribute = name.partition(":")
    if _top(module_name) not in ("hexctl", *sys.stdlib_module_names):
        _CUSTOM.setdefault(_top(module_name), "")
    module = module_here(module_name)
    if module_name == "__main__" and not hasattr(module, attribute):
        raise ImportError(
            f"it is of the script that began the session, to be continued from Python: "
            f"hexctl.Adaptation.resume(NAME, {part}={attribute}).run()"
        )
    return getattr(module, attribute)


def load_custom(
    name: str, part: str, *, known: Iterable[str], allowed: str, door: Door | None = None
) -> tuple[Any, str]:
    """The object of a plug-in's name or of `package.module:name`, and its name for messages.

    Args:
        part: its argument of the library, such as `optimizer`.
        known: built-in names.
        allowed: a short description of the object.

    Raises:
        InputError: for an unknown name, and for an object that cannot be loaded.
    """
    what = argument(part)
    try:
        plugin = None if door is None else find_plugin(door, name)
        if plugin is not None:
            return plugin.load(), str(plugin)
        if ":" in name:
            # The servos of a script are resumed as `servos=`, not as a name of a backend.
            load = partial(load_named, name, "servos" if part == "backend" else part)
            return _imported(load, name, f"allowed: {allowed}"), name
    except InputError as error:
        raise InputError(f"{what}: {error}") from error
    names = list(dict.fromkeys((*known, *(plugin_names(door) if door else ()))))
    listed = f"{', '.join(names)}, package.module:name for {allowed}"
    raise InputError(f"{what}: got {name!r}; allowed: {listed}{nearest(name, names)}")


def made_by(make: Callable[[], Any], label: str, kind: type[MadeT], part: str, allowed: str) -> MadeT:
    """What custom code makes; raises InputError with its label for an error, and for another kind."""
    what = f"{argument(part)}: {label}"
    try:
        made = make()
    except Exception as error:
        if isinstance(error, HexctlError) and not isinstance(error, InputError):
            raise
        raise InputError(f"{what} cannot be made ({why(error)}); allowed: {allowed}") from error
    check_type(made, kind, what, allowed)
    return made  # type: ignore[no-any-return]


def made_of(
    name: str,
    named: Mapping[str, Callable[[], MadeT]],
    kind: type[MadeT],
    part: str,
    door: Door | None = None,
) -> MadeT:
    """An object of a kind: of a name in `named`, of a plug-in or of `package.module:Class`; or InputError."""
    if name in named:
        return named[name]()
    allowed = f"a {kind.__name__}"
    custom, label = load_custom(name, part, known=named, allowed=allowed, door=door)
    return made_by(custom if isinstance(custom, type) else lambda: custom, label, kind, part, allowed)
