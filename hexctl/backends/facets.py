"""What only some servos know and can do: those of a simulation, and those behind a server."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Protocol

from hexctl.robot.failure import Failure
from hexctl.types import FloatArray

if TYPE_CHECKING:
    from hexctl.wire.description import RobotIdentity
    from hexctl.wire.links import Link

#: Position (3,) and orientation (4,), with the same leading shape.
TruePose = tuple[FloatArray, FloatArray]


class SimulationFacet(Protocol):
    """What only a simulation knows and can do.

    Results are scored with it and recordings show it. Controllers must not use it.
    """

    @property
    def true_pose(self) -> TruePose | None:
        """True position (3,) in m and orientation (4,) of the base in the world; None before `connect`."""

    @property
    def failures(self) -> tuple[Failure, ...]:
        """Failures in force now, by leg; before `connect` those that it begins with."""

    def change_leg(self, leg: int, failure: Failure | None) -> None:
        """Let a leg fail now, or heal for None.

        Raises RobotFaultError before `connect`, InputError for a failure that cannot be.
        """

    def walk_begins(self) -> None:
        """Count the times of the failures to come from here."""


class RemoteFacet(Protocol):
    """The link to a server, and what the server reports of its robot."""

    @property
    def link(self) -> "Link":
        """Endpoint, credentials and key names of the link."""

    @property
    def identity(self) -> "RobotIdentity | None":
        """Which robot answered and who started it; None before `connect`, and on a plain link."""

    @property
    def simulated(self) -> Mapping[str, str] | None:
        """World and failure of a simulation as text, `world` and `failure`; None for a robot."""

    @property
    def failures(self) -> tuple[Failure, ...] | None:
        """Failures in force in a simulation, by leg, as reported last; None for a robot."""
