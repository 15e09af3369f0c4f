"""Plug-ins of installed distributions, and custom objects named as `package.module:name`.

A distribution offers an object by an entry point in a group such as `hexctl.optimizers`. Names are read from
metadata; the object is imported when it is used.
"""

import os
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pkgutil import resolve_name
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from hexctl.errors import EXTRAS, HexctlError, InputError, MissingExtraError, argument
from hexctl.typed_names import nearest

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

MadeT = TypeVar("MadeT")

#: What plug-ins may be: the last word of a group of entry points.
Door = Literal["servos", "families", "boards", "optimizers", "recoveries", "commands", "arenas"]


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
        """The distribution's summary, for a help text."""
        metadata = self.entry.dist.metadata.json if self.entry.dist else {}
        return f"{str(metadata.get('summary', '')).rstrip('.')} ({self.distribution})."

    def load(self) -> Any:
        """Import the object; raises InputError that names the distribution, or MissingExtraError."""
        try:
            with redirect_stdout(sys.stderr):  # what its import prints is no output of a command
                return self.entry.load()
        except (Exception, SystemExit) as error:
            extra = EXTRAS.get((getattr(error, "name", None) or "").partition(".")[0])
            if isinstance(error, ModuleNotFoundError) and extra is not None:
                raise MissingExtraError(self.entry.name, extra) from error
            why = f"{type(error).__name__}: {error}"
            raise InputError(f"{self} cannot be loaded ({why}); repair or uninstall it") from error


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


def find_named(door: Door, name: str, own: Mapping[str, str], kind: type[MadeT], part: str) -> MadeT:
    """The object of a name, which it has as `name`: hexctl's own of `module:name`, else a plug-in's.

    Raises InputError for an unknown name, and for a plug-in without such an object.
    """
    if name in own:
        found: MadeT = resolve_name(own[name])
        return found
    plugin, what = find_plugin(door, name), argument(part)
    if plugin is None:
        known = tuple(dict.fromkeys((*own, *plugin_names(door))))
        raise InputError(f"{what}: got {name!r}; allowed: {', '.join(known)}{nearest(name, known)}")
    loaded = plugin.load()
    if not isinstance(loaded, kind) or getattr(loaded, "name", None) != name:
        named = f" named {loaded.name!r}" if isinstance(loaded, kind) else ""  # type: ignore[attr-defined]
        got = f"{plugin} is a {type(loaded).__name__}{named}"
        raise InputError(f"{what}: {got}; allowed: a {kind.__name__} named {name!r}")
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
    except InputError as error:
        raise InputError(f"{what}: {error}") from error
    if ":" not in name:
        names = [*known, *(plugin_names(door) if door else ())]
        listed = f"{', '.join(names)}, package.module:name for {allowed}"
        raise InputError(f"{what}: got {name!r}; allowed: {listed}{nearest(name, names)}")
    try:
        # The servos of a script are resumed as `servos=`, not as a name of a backend.
        return load_named(name, "servos" if part == "backend" else part), name
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise InputError(f"{what}: {name} cannot be loaded ({error}); allowed: {allowed}") from error


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
    try:
        made = custom() if isinstance(custom, type) else custom
    except (HexctlError, AttributeError, TypeError, ValueError) as error:
        raise InputError(f"{argument(part)}: {label} cannot be made ({error}); allowed: {allowed}") from error
    if not isinstance(made, kind):
        raise InputError(f"{argument(part)}: got {label}, a {type(made).__name__}; allowed: {allowed}")
    return made
