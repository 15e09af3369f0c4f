"""Base classes and helpers for custom recoveries and servo drivers; imported when first used."""

from typing import TYPE_CHECKING, Any

from hexctl.lazy_names import lazy_names

if TYPE_CHECKING:
    from hexctl.backends.base import check_connected, check_targets
    from hexctl.backends.clock import WallClock
    from hexctl.control.monitor.monitored_walk import recovering_walk
    from hexctl.control.monitor.recovery import Recovery, Response
    from hexctl.control.preparation import WalkStart
    from hexctl.robot.loader import load_robot_file

# fmt: off
__all__ = [
    "WalkStart", "Recovery", "Response", "recovering_walk",
    "WallClock", "check_connected", "check_targets", "load_robot_file",
]
# fmt: on

_load = lazy_names("hexctl", __file__, __all__)


def __getattr__(name: str) -> Any:
    return _load(name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
