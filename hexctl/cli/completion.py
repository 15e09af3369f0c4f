"""Shell completion of option values, once `hexctl --install-completion` has been run.

Functions import late, to keep `hexctl --help` and the Tab key fast. Without a match the shell offers files.
"""

from collections.abc import Callable, Iterable
from typing import Any

from hexctl.cli.settings import runs_folder
from hexctl.errors import HexctlError

Words = list[str]


def _offered(words: Callable[[], Iterable[str]]) -> Callable[[str], Words]:
    """An error completes to nothing, because the shell has no place for messages."""

    def complete(incomplete: str) -> Words:
        try:
            return [word for word in words() if word.startswith(incomplete)]
        except (HexctlError, OSError):
            return []

    return complete


def _robots() -> Iterable[str]:
    from hexctl.robot.configs import config_names

    return config_names("robots")


def _worlds() -> Iterable[str]:
    from hexctl.robot.configs import is_family

    # A family is not a world; its first member shows how members are named.
    return [f"{name}:0" if is_family(content) else name for name, content in _world_files()]


def _families() -> Iterable[str]:
    from hexctl.robot.configs import is_family

    # Families for priors: none of their legs fails during a walk.
    return [name for name, content in _world_files() if is_family(content) and "failures" not in content]


def _world_files() -> Iterable[tuple[str, dict[str, Any]]]:
    from hexctl.robot.configs import config_names, find_config, read_mapping

    return [(name, read_mapping(find_config("worlds", name))) for name in config_names("worlds")]


def _gaits() -> Iterable[str]:
    from hexctl.gait.gait import AUTO, NAMED_SLOTS

    return (AUTO, "best", *NAMED_SLOTS)


def _kinds() -> Iterable[str]:
    from hexctl.robot.failure import FAILURE_KINDS

    return FAILURE_KINDS


def _failures() -> Iterable[str]:
    return (f"{leg}:{kind}" for leg in range(1, 7) for kind in _kinds())


def _backends() -> Iterable[str]:
    from hexctl.backends.registry import BACKENDS

    return BACKENDS


def _optimizers() -> Iterable[str]:
    from hexctl.adapt.optimizers.shipped import NAMES

    return NAMES


def _objectives() -> Iterable[str]:
    from hexctl.adapt.objectives import OBJECTIVES

    return OBJECTIVES


def _gamepads() -> Iterable[str]:
    from hexctl.teleop.gamepad import find_gamepads

    return ("auto", "none", *map(str, find_gamepads()))


def _sessions() -> Iterable[str]:
    from hexctl.adapt.sessions.store import stored_names

    return stored_names(runs_folder())


def _viewable() -> Iterable[str]:
    return [*_sessions(), *map(str, runs_folder().glob("*.rrd"))]


robots = _offered(_robots)
worlds = _offered(_worlds)
gaits = _offered(_gaits)
failures = _offered(_failures)
kinds = _offered(_kinds)
failed_legs = _offered(lambda: [*map(str, range(1, 7)), "auto"])
backends = _offered(_backends)
served_backends = _offered(lambda: [name for name in _backends() if name != "zenoh"])
optimizers = _offered(_optimizers)
objectives = _offered(_objectives)
gamepads = _offered(_gamepads)
priors = _offered(lambda: ("auto", "none"))
families = _offered(_families)
sessions = _offered(_sessions)
viewable = _offered(_viewable)
exportable = _offered(lambda: [*_robots(), *_viewable()])
