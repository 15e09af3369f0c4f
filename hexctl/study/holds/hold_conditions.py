"""Conditions of the compared walks: one robot in one world, and what fails and is held in each walk."""

import hashlib
import json
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

from hexctl.backends.sim.world import World
from hexctl.control.assessment.static_stability import stable_gait
from hexctl.control.batch import SimTrial
from hexctl.control.trial_plan import AUTO_ROTATION, TrialPlan, suited_rotation
from hexctl.gait.gait import Gait
from hexctl.robot.failure import Failure
from hexctl.robot.failure_grammar import parse_kind
from hexctl.robot.model import Robot
from hexctl.study.landscapes.versions import code_versions, source_digest

#: What walks hold, from the least to the most.
HOLDS = ("none", "heading", "line")

#: The failure of a robot with six good legs.
INTACT = "intact"

#: What sensors of the compared walks are like: two ticks late, 1 cm, half a degree, a pose in twenty lost.
SENSORS: dict[str, Any] = {
    "state_latency_s": 0.04,
    "sensor_noise": {"position_m": 0.01, "yaw_deg": 0.5},
    "lost_poses": 0.05,
}


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class HoldCase:
    """One walk under some conditions.

    Attributes:
        leg: the failed leg, 1..6; 0 for an intact robot.
        failure: of the leg, in the words of `parse_kind`; `intact` without one.
        hold: what the walk holds, one of `HOLDS`.
    """

    leg: int
    failure: str
    hold: str

    @property
    def leg_failure(self) -> Failure | None:
        """The failure, as the simulation is given it and the controller believes it."""
        return parse_kind(self.leg, self.failure) if self.leg else None


@dataclass(frozen=True, kw_only=True)
class HoldConditions:
    """One robot in one world; a walk there is decided by this and its case.

    Attributes:
        robot: model of the robot.
        family: name of the world's family.
        number: of the world in its family, and the seed of what is drawn in it.
        kind: kind of the world, as the family names it.
        world: the world, its sensors included.
        self_rotation: where the failed leg points during the walk, as `HoldPlan` has it.
        duration_s: length of each walk.
    """

    robot: Robot
    family: str
    number: int
    kind: str
    world: World
    self_rotation: str = AUTO_ROTATION
    duration_s: float = 30.0

    @property
    def title(self) -> str:
        """Name for progress and messages."""
        return f"{self.robot.name}, {self.family}:{self.number} ({self.kind})"

    @property
    def rough(self) -> bool:
        """Whether the floor is uneven."""
        return self.world.roughness_m > 0

    def trial(self, case: HoldCase) -> SimTrial:
        """Trial of a case, with the gait that stands safest."""
        gait = self.robot.gait
        plan = TrialPlan(
            gait=Gait(
                slots=(1, 2, 3, 4, 5, 6), pace_hz=gait.pace_hz, amplitude=gait.amplitude, height=gait.height
            ),
            duration_s=self.duration_s,
            belief=case.leg_failure,
            self_rotation=suited_rotation(
                self.self_rotation, "line" if case.hold == "none" else case.hold, chosen_gait=True
            ),
            hold=case.hold,
        )
        plan = replace(plan, gait=_gait_of(self.robot, plan))
        return SimTrial(robot=self.robot, plan=plan, failure=plan.belief, world=self.world, seed=self.number)

    def identity(self) -> dict[str, Any]:
        """Plain JSON values that are equal where walks are: settings and versions of the code."""
        return {
            "robot": self.robot.fingerprint,
            "world": self.world.model_dump(mode="json"),
            "seed": self.number,
            "self_rotation": self.self_rotation,
            "duration_s": self.duration_s,
            "code": _versions(),
        }

    @property
    def fingerprint(self) -> str:
        """Digest of the identity, 16 hexadecimal digits."""
        return hashlib.sha256(json.dumps(self.identity(), sort_keys=True).encode()).hexdigest()[:16]


def with_sensors(world: World) -> World:
    """A world whose sensors are `SENSORS`."""
    return World.model_validate(world.model_dump() | SENSORS)


@cache
def _versions() -> dict[str, str]:
    return code_versions() | {"source": source_digest(__name__)}


#: Gaits by robot and plan: they are the same in all worlds.
_gait_of = cache(stable_gait)
