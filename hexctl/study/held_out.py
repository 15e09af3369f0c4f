"""Held-out worlds: robots in worlds that nothing was developed with."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

from hexctl.backends.sim.world import DomainRandomization, World
from hexctl.robot.model import Robot
from hexctl.study.walk_cache import CaseT, Place, WalkT
from hexctl.types import JOINT_KINDS

#: Failure of an intact robot.
INTACT = "intact"

#: Default failures during a walk, of legs and of single joints.
FAILURES = (
    "locked",
    "limp",
    "missing",
    *(f"{kind}:{joint}" for kind in ("stuck", "limp") for joint in JOINT_KINDS),
)

#: Sensors of the compared walks: two ticks late, 1 cm and half a degree of noise, 5 % of the poses lost.
SENSORS: dict[str, Any] = {
    "state_latency_s": 0.04,
    "sensor_noise": {"position_m": 0.01, "yaw_deg": 0.5},
    "lost_poses": 0.05,
}


@dataclass(frozen=True, kw_only=True)
class HeldOutPlace(Place[CaseT, WalkT]):
    """A robot in a member of a family of worlds.

    Attributes:
        number: number of the world in its family, and the seed of everything drawn in it.
    """

    #: First word of the cache file's name.
    KIND: ClassVar[str]

    family: str
    number: int
    kind: str

    @property
    def stem(self) -> str:
        """First part of the cache file's name."""
        return f"{self.KIND}-{self.number}"

    @property
    def title(self) -> str:
        """Name for progress and messages."""
        return f"{self.robot.name}, {self.family}:{self.number} ({self.kind})"

    def settings(self) -> dict[str, Any]:
        """Seed of the world."""
        return {"seed": self.number}

    def columns(self) -> dict[str, Any]:
        """Values of each row of this place."""
        return {
            "robot": self.robot.name,
            "family": self.family,
            "world": self.number,
            "kind_of_world": self.kind,
        }

    def row(self, walk: Any) -> dict[str, Any]:
        """Values of the row of a walk: of the place, the case and the outcome."""
        values: dict[str, Any] = asdict(walk)
        case: dict[str, Any] = values.pop("case")
        return self.columns() | case | values


def with_sensors(world: World) -> World:
    """Return a world whose sensors are `SENSORS`."""
    return World.model_validate(world.model_dump() | SENSORS)


def members(
    robots: Sequence[Robot], families: Mapping[str, DomainRandomization], first: int, count: int
) -> Iterator[dict[str, Any]]:
    """Return the fields of a `HeldOutPlace` for each robot in some members of each family."""
    for robot in robots:
        for name, family in families.items():
            for number, world in enumerate(family.members(first, count), first):
                kind = family.kind(number).name
                yield {"robot": robot, "family": name, "number": number, "kind": kind, "world": world}
