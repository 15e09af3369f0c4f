"""The modules with targets."""

from importlib import import_module

from tests.fuzz.target import Target

ROOMS = ("text", "wire", "served", "servos", "mavlink", "documents", "stores", "teleop")


def targets_of(room: str) -> tuple[Target, ...]:
    """Targets of a module of this package."""
    content = vars(import_module(f"tests.fuzz.rooms.{room}")).values()
    return tuple(each for each in content if isinstance(each, Target))


def all_targets() -> tuple[Target, ...]:
    """Targets of all rooms."""
    return tuple(target for room in ROOMS for target in targets_of(room))
