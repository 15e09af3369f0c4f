"""Walks of the comparison of holds: robot, world, failure, hold and outcome."""

import math
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from hexctl.control.batch import SimTrial
from hexctl.control.trial_plan import AUTO_ROTATION, AskedRotation, suited_rotation
from hexctl.control.trial_result import STATUSES, TrialResult
from hexctl.gait.gait import AUTO
from hexctl.robot.failure import Failure
from hexctl.robot.failure_grammar import parse_kind
from hexctl.runs.run_spec import RunSpec
from hexctl.runs.walk_plan import plan_walk
from hexctl.study.held_out import HeldOutPlace
from hexctl.study.walk_cache import known

Hold = Literal["none", "heading", "line"]


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class HoldCase:
    """One walk in a place.

    Attributes:
        leg: failed leg, 1..6; 0 for an intact robot.
        failure: as `parse_kind` reads it; `intact` without one.
    """

    leg: int
    failure: str
    hold: Hold

    @property
    def leg_failure(self) -> Failure | None:
        """The failure, of the simulation, which the controller knows."""
        return parse_kind(self.leg, self.failure) if self.leg else None


@dataclass(frozen=True, slots=True, kw_only=True)
class HoldWalk:
    """Outcome of one walk; deviations are those of the simulation's true pose, NaN if unknown.

    Attributes:
        why: why it was stopped, or the likely cause of a walk without progress.
        signed_m: deviation at the end, positive to the left.
        ideal_distance_m: progress of a robot whose feet do not slip.
    """

    case: HoldCase
    held: str
    status: Literal[STATUSES]  # type: ignore[valid-type]
    why: str | None
    duration_s: float
    signed_m: float
    max_m: float
    distance_m: float
    ideal_distance_m: float

    @classmethod
    def of(cls, case: HoldCase, _trial: SimTrial, result: TrialResult) -> "HoldWalk":
        """Return the outcome of a case from the result of its trial."""
        off = result.true_deviation
        signed_m, max_m = (math.nan, math.nan) if off is None else (off.signed, off.max)
        return cls(
            case=case,
            held=result.hold,
            status=result.status,
            why=result.stopped or result.cause,
            duration_s=float(result.duration_s),
            signed_m=float(signed_m),
            max_m=float(max_m),
            distance_m=known(result.distance_m),
            ideal_distance_m=float(result.ideal_distance_m),
        )


@dataclass(frozen=True, kw_only=True)
class HoldPlace(HeldOutPlace[HoldCase, HoldWalk]):
    """A robot in a world; `self_rotation` is that of `HoldPlan`."""

    WALK: ClassVar[type[HoldWalk]] = HoldWalk
    KIND: ClassVar[str] = "hold"

    self_rotation: AskedRotation = AUTO_ROTATION
    duration_s: float = 30.0

    def settings(self) -> dict[str, Any]:
        """Settings that decide a walk."""
        mine = {"self_rotation": self.self_rotation, "duration_s": self.duration_s}
        return super().settings() | mine

    def columns(self) -> dict[str, Any]:
        """Values of each row of this place."""
        return super().columns() | {"rough": self.world.roughness_m > 0}

    def chunk_of(self, case: HoldCase) -> Hashable:
        """Walks with the same feedback are simulated together."""
        return case.hold

    def trial(self, case: HoldCase) -> SimTrial:
        """Return the trial of a case, with the gait of the largest stability margin."""
        rotation_of = "line" if case.hold == "none" else case.hold
        walk = RunSpec(
            gait=AUTO,
            duration_s=self.duration_s,
            failure=case.leg_failure,
            self_rotation=suited_rotation(self.self_rotation, rotation_of, chosen_gait=True),
            hold=case.hold,
        )
        plan = plan_walk(walk, self.robot)
        return SimTrial(
            robot=self.robot, plan=plan, failures=plan.failures, world=self.world, seed=self.number
        )
