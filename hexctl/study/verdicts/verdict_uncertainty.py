"""The simulation's own uncertainty beside the deviations of a study."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hexctl.backends.sim.world import World
from hexctl.control.assessment.uncertainty_store import (
    DISTINCT,
    MEASURED_FAILURE,
    SimulationUncertainty,
    known_uncertainty,
)
from hexctl.robot.model import Robot
from hexctl.study.verdicts.claim_evidence import JUDGED_FROM_S, cm


@dataclass(frozen=True, slots=True)
class StudyUncertainty:
    """What is known of the uncertainty of the walks of a study.

    Attributes:
        known: as measured; None where it was not.
    """

    known: SimulationUncertainty | None = None
    duration_s: float = JUDGED_FROM_S
    failure: str = MEASURED_FAILURE

    @classmethod
    def of(
        cls,
        robot: Robot,
        world: World,
        duration_s: float,
        folder: Path | str = "runs",
        *,
        failure: str = MEASURED_FAILURE,
    ) -> "StudyUncertainty":
        """Uncertainty of a robot's walks in a world, as measured before; `folder` is that of sessions.

        Raises InputError for a damaged file of measurements.
        """
        known = known_uncertainty(robot, world, duration_s=duration_s, folder=folder)
        return cls(known, duration_s, failure)

    @property
    def sentence(self) -> str:
        """What a reader should know of it."""
        if self.known is None:
            return (
                "The simulation's own uncertainty is not known for these walks; hexctl check ROBOT --physics "
                "measures it."
            )
        caveat = self.known.caveat(self.failure)
        return (
            f"Every deviation of a single walk is ± {cm(self.known.numerical_m)} by the simulation's own "
            f"uncertainty (by its time step{f'; {caveat}' if caveat else ''}): two gaits whose ends are "
            f"nearer to one another than {DISTINCT} times this, {cm(DISTINCT * self.known.numerical_m)}, "
            "cannot be told apart with a confidence of 95 %."
        )

    @property
    def lines(self) -> list[str]:
        """The sentence as lines of a summary; none if unknown for walks that are too short to be judged."""
        return [self.sentence] if self.known is not None or self.duration_s >= JUDGED_FROM_S else []

    def beside(self, deviation_m: float) -> str:
        """The deviation of a single walk with its uncertainty, where that is known."""
        return cm(deviation_m) + ("" if self.known is None else f" ± {cm(self.known.numerical_m)}")

    def as_json(self) -> dict[str, Any] | None:
        """As in `hexctl check --physics --json`; None where it is not known."""
        return None if self.known is None else self.known.to_dict()
