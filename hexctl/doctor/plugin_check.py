"""Plug-ins of installed distributions, and whether each of them loads."""

from collections.abc import Callable, Container
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

from hexctl.adapt.optimizer import Optimizer
from hexctl.adapt.optimizers.shipped import NAMES
from hexctl.backends.base import LegServos
from hexctl.backends.bus.family import Family, find_family
from hexctl.backends.pwm.pulse_board import PulseBoard, find_board
from hexctl.backends.registry import BACKENDS
from hexctl.control.monitor.recovery import RECOVERIES, Recovery
from hexctl.doctor.settings_check import without_home
from hexctl.errors import HexctlError, shown
from hexctl.robot.plugins import Door, Plugin, find_plugin, plugins, show_traceback
from hexctl.robot.servos.drivers import BOARDS, FAMILIES

#: How users find the objects of doors whose names must fit.
FINDERS: dict[Door, Callable[[str], object]] = {"families": find_family, "boards": find_board}


@dataclass(frozen=True, slots=True, kw_only=True)
class PluginReport:
    """One plug-in: group and name of its entry point, its distribution, and the error if it does not load."""

    group: str
    name: str
    distribution: str
    version: str
    error: str | None


def read_plugins(commands: Container[str] = ()) -> tuple[PluginReport, ...]:
    """Plug-ins of others, each imported, and own ones without a module; `commands` are taken names."""
    doors: dict[Door, tuple[Container[str], Any]] = {
        "servos": (BACKENDS, LegServos),
        "families": (FAMILIES, Family),
        "boards": (BOARDS, PulseBoard),
        "optimizers": (NAMES, Optimizer),
        "recoveries": (RECOVERIES, Recovery),
        "commands": (commands, Callable),
        "arenas": ((), Callable),
    }
    return tuple(
        PluginReport(
            group=plugin.entry.group,
            name=plugin.entry.name,
            distribution=plugin.distribution.partition(" ")[0],
            version=plugin.distribution.partition(" ")[2],
            error=_problem(plugin, taken, kind),
        )
        for door, (taken, kind) in doors.items()
        for plugin in plugins(door)
        if not (plugin.is_own and _is_present(plugin.entry.module))
    )


def _is_present(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # of its package
        return False


def _problem(plugin: Plugin, taken: Container[str], kind: Any) -> str | None:
    if plugin.entry.name in taken and not plugin.is_own:
        return f"hexctl has a {plugin.entry.name}, too, which is used; rename the entry point"
    try:
        find_plugin(plugin.door, plugin.entry.name)
        finder = FINDERS.get(plugin.door)
        found: Any = plugin.load() if finder is None else finder(plugin.entry.name)
    except HexctlError as error:
        show_traceback(error)
        text = without_home(str(error))
        return text.partition(str(plugin))[2].lstrip(": ") or text
    is_class = isinstance(found, type)
    factory = not is_class and callable(found)
    if kind is Callable:
        return None if factory else f"got {shown(found)}; allowed: a function"
    fits = issubclass(found, kind) if is_class else isinstance(found, kind)
    allowed = fits or (plugin.door == "servos" and factory)
    return None if allowed else f"got {shown(found)}; allowed: a class of {kind.__name__}"
