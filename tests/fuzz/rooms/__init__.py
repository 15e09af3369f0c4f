"""The modules with targets, and what of the programs that they attack is watched for coverage."""

from importlib import import_module

from tests.fuzz.target import Target

#: Packages whose branches are watched, by the module with the targets.
ROOMS: dict[str, tuple[str, ...]] = {
    "text": ("hexctl",),
    "wire": ("hexctl", "rosbags"),
    "served": ("hexctl",),
    "bus": ("hexctl",),
    "boards": ("hexctl",),
    "mavlink": ("hexctl",),
    "documents": ("hexctl", "yaml"),
    "models": ("hexctl",),
    "stores": ("hexctl",),
    "teleop": ("hexctl",),
}


def targets_of(room: str) -> tuple[Target, ...]:
    """Targets of a module of this package."""
    found: tuple[Target, ...] = import_module(f"tests.fuzz.rooms.{room}").TARGETS
    return found


def all_targets() -> tuple[Target, ...]:
    """Targets of all rooms."""
    return tuple(target for room in ROOMS for target in targets_of(room))
