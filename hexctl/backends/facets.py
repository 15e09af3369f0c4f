"""Features of only some servos: of simulations, and behind a server."""

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
    """State and controls of a simulation, for scores and recordings; controllers must not use it."""

    @property
    def true_pose(self) -> TruePose | None:
        """True position (3,) in m and orientation (4,) of the base in the world; None before `connect`."""

    @property
    def failures(self) -> tuple[Failure, ...]:
        """Current failures, by leg; before `connect` those at the start."""

    def change_leg(self, leg: int, failure: Failure | None) -> None:
        """Let a leg fail now, or heal for None.

        Raises RobotFaultError before `connect`, InputError for an impossible failure.
        """

    def walk_begins(self) -> None:
        """Set the zero of the times of scheduled failures."""


class RemoteFacet(Protocol):
    """The link to a server, and what the server reports of its robot."""

    @property
    def link(self) -> "Link":
        """Endpoint, credentials and key names of the link."""

    @property
    def identity(self) -> "RobotIdentity | None":
        """Robot that answered and who started it; None before `connect`, and on a plain link."""

    @property
    def simulated(self) -> Mapping[str, str] | None:
        """World and failure of a simulation as text, `world` and `failure`; None for a robot."""

    @property
    def failures(self) -> tuple[Failure, ...] | None:
        """Last reported failures of a simulation, by leg; None for a robot."""
