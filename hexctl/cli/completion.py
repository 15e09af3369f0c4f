"""Shell completion of option values, once `hexctl --install-completion` has been run.

Functions import late, to keep `hexctl --help` and the Tab key fast. Without a match the shell offers files.
"""

from collections.abc import Callable, Iterable
from importlib import import_module
from typing import TYPE_CHECKING, Any

from hexctl.cli.settings import runs_folder
from hexctl.errors import HexctlError

if TYPE_CHECKING:
    from hexctl.robot.plugins import Door

Words = list[str]


def _offered(words: Callable[[], Iterable[str]]) -> Callable[[str], Words]:
    """An error completes to nothing, because the shell has no place for messages."""

    def complete(incomplete: str) -> Words:
        try:
            return [word for word in dict.fromkeys(words()) if word.startswith(incomplete)]
        except (HexctlError, OSError):
            return []

    return complete


def _constant(module: str, name: str, door: "Door | None" = None) -> Callable[[str], Words]:
    """Names in a module, then those of plug-ins, none of which is imported."""

    def words() -> Iterable[str]:
        from hexctl.robot.plugins import plugin_names

        return (*getattr(import_module(f"hexctl.{module}"), name), *(plugin_names(door) if door else ()))

    return _offered(words)


@_offered
def robots() -> Iterable[str]:
    """Shipped robots."""
    from hexctl.robot.configs import config_names

    return config_names("robots")


@_offered
def worlds() -> Iterable[str]:
    """Shipped worlds."""
    from hexctl.robot.configs import is_family

    # A family is not a world; its first member shows how members are named.
    return [f"{name}:0" if is_family(content) else name for name, content in _world_files()]


@_offered
def families() -> Iterable[str]:
    """Families of worlds for priors: none of their legs fails during a walk."""
    from hexctl.robot.configs import is_family

    return [name for name, content in _world_files() if is_family(content) and "failures" not in content]


def _world_files() -> Iterable[tuple[str, dict[str, Any]]]:
    from hexctl.robot.configs import config_names, find_config, read_mapping

    return [(name, read_mapping(find_config("worlds", name))) for name in config_names("worlds")]


@_offered
def gaits() -> Iterable[str]:
    """Named gaits."""
    from hexctl.gait.gait import AUTO, NAMED_SLOTS

    return (AUTO, "best", *NAMED_SLOTS)


kinds = _constant("robot.failure", "FAILURE_KINDS")
failures = _offered(lambda: [f"{leg}:{kind}" for leg in range(1, 7) for kind in kinds("")])
failed_legs = _offered(lambda: [*map(str, range(1, 7)), "auto"])


@_offered
def backends() -> Iterable[str]:
    """Backends."""
    from hexctl.backends.registry import backend_names

    return backend_names()


@_offered
def drivers() -> Iterable[str]:
    """Families of bus servos."""
    from hexctl.robot.servos.drivers import bus_drivers

    return bus_drivers()


@_offered
def buses() -> Iterable[str]:
    """Families of bus servos, and boards."""
    from hexctl.robot.servos.drivers import all_drivers

    return all_drivers()


served_backends = _offered(lambda: [name for name in backends("") if name != "zenoh"])


optimizers = _constant("adapt.optimizers.shipped", "NAMES", "optimizers")
searches = _constant("adapt.optimizers.shipped", "OPTIMIZERS", "optimizers")
recoveries = _constant("control.monitor.recovery", "RECOVERIES", "recoveries")
objectives = _constant("adapt.objectives", "OBJECTIVES")


@_offered
def gamepads() -> Iterable[str]:
    """Gamepads, and the words for any and for none."""
    from hexctl.teleop.gamepad import find_gamepads

    return ("auto", "none", *map(str, find_gamepads()))


priors = _offered(lambda: ("auto", "none"))


@_offered
def sessions() -> Iterable[str]:
    """Stored sessions."""
    from hexctl.adapt.sessions.store import stored_names

    return stored_names(runs_folder())


viewable = _offered(lambda: [*sessions(""), *map(str, runs_folder().glob("*.rrd"))])
exportable = _offered(lambda: [*robots(""), *viewable("")])
