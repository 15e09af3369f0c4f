"""The modules with targets, and what of the programs that they attack is watched for coverage."""

from importlib import import_module

from tests.fuzz.target import Target

#: Packages whose branches are watched, by the module of `tests.fuzz` with the targets.
ROOMS: dict[str, tuple[str, ...]] = {
    "text": ("hexctl", "yaml"),
}


def targets_of(room: str) -> tuple[Target, ...]:
    """Targets of a module of `tests.fuzz`."""
    found: tuple[Target, ...] = import_module(f"tests.fuzz.{room}").TARGETS
    return found


def all_targets() -> tuple[Target, ...]:
    """Targets of all rooms."""
    return tuple(target for room in ROOMS for target in targets_of(room))
