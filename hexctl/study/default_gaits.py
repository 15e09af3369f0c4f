"""Default gaits: where a robot with a failed leg ends without a search, with its own gait and the tripod."""

from dataclasses import dataclass

from hexctl.study.landscapes.landscape import GaitWalk
from hexctl.study.verdicts.claim_evidence import number

#: Gaits of a robot that knows of no failure: its default one, and the tripod.
DEFAULT_GAITS = ("demo", "tripod")


@dataclass(frozen=True, slots=True, kw_only=True)
class DefaultWalk:
    """One walk with a default gait, under the conditions of a landscape.

    Attributes:
        leg: the failed leg.
        gait: one of `DEFAULT_GAITS`.
        status: one of `hexctl.control.trial_result.STATUSES`.
        signed_m: deviation at the end, positive to the left; None if unknown.
        distance_m: progress along the heading; None if unknown.
    """

    leg: int
    gait: str
    status: str
    signed_m: float | None
    distance_m: float | None

    @classmethod
    def of(cls, leg: int, walk: GaitWalk) -> "DefaultWalk":
        """Return the walk of a leg."""
        ends = {"signed_m": number(walk.signed_m), "distance_m": number(walk.distance_m)}
        return cls(leg=leg, gait=str(walk.case), status=walk.status, **ends)

    @property
    def final_m(self) -> float | None:
        """Deviation at the end; None for an invalid walk."""
        return None if self.status != "ok" or self.signed_m is None else abs(self.signed_m)
