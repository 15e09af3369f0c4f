"""The walks of a repertoire: a failure, a change to a candidate, and the speed after it."""

import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any
from zlib import crc32

import numpy as np

from hexctl.backends.sim.world import World
from hexctl.control.batch import SimTrial, run_sim_trials
from hexctl.control.monitor.repertoire import (
    INTACT_GAIT,
    Candidate,
)
from hexctl.control.trial_plan import GaitChange, TrialPlan
from hexctl.control.trial_result import STATUSES, TrialResult
from hexctl.gait.gait import ideal_speed_m_s, make_gait
from hexctl.robot.failure_grammar import parse_failure_event
from hexctl.robot.model import Robot
from hexctl.study.landscapes.benchmark_walks import WalkCache
from hexctl.study.landscapes.cache import LandscapeCache
from hexctl.study.landscapes.versions import code_versions, source_digest
from hexctl.study.recovery.episodes import ENDED, Track

#: When the gait changes, and the failure comes before it at the latest and the earliest, in cycles.
CHANGE_CYCLES, ALARM_CYCLES, PHASES_CYCLES = 2.6, 0.4, 1.0

#: From when after the change on the speed is measured, and for how long, in cycles.
SETTLES_CYCLES, MEASURED_CYCLES = 2.0, 3.0


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class RepertoireCase:
    """One walk under some conditions.

    Attributes:
        failures: leg and words of each failure, such as `5:stuck:femur`.
        heading_deg: direction of travel.
        candidate: gait and posture that the robot changes to.
    """

    failures: tuple[str, ...]
    heading_deg: float
    candidate: Candidate


@dataclass(frozen=True, kw_only=True)
class RepertoireConditions:
    """One robot in one world; a walk there is decided by this and its case.

    Attributes:
        robot: model of the robot.
        family: name of the world's family.
        number: of the world in its family, and the seed of what is drawn in it.
        world: the world.
    """

    robot: Robot
    family: str
    number: int
    world: World

    @property
    def title(self) -> str:
        """Name for progress and messages."""
        return f"{self.robot.name}, {self.family}:{self.number}"

    @property
    def change_s(self) -> float:
        """When the gait changes."""
        return round(CHANGE_CYCLES / self.robot.gait.pace_hz, 2)

    @property
    def measured_s(self) -> tuple[float, float]:
        """From when until when the speed is measured; the walk ends then."""
        first_s = self.change_s + SETTLES_CYCLES / self.robot.gait.pace_hz
        return first_s, first_s + MEASURED_CYCLES / self.robot.gait.pace_hz

    def trial(self, case: RepertoireCase) -> SimTrial:
        """Trial of a case: the failure comes at a random phase, and the gait changes an alarm later."""
        gait = make_gait(self.robot, INTACT_GAIT)
        text = f"{self.family} {case.failures} {case.heading_deg:g}"
        share = np.random.default_rng([self.number, crc32(text.encode())]).uniform()
        before_s = (ALARM_CYCLES + PHASES_CYCLES * share) / gait.pace_hz
        at_s = self.change_s - before_s
        plan = TrialPlan(
            gait=gait,
            heading_rad=math.radians(case.heading_deg),
            duration_s=self.measured_s[1],
            self_rotation="none",
            hold="line",
            changes=(GaitChange(gait=case.candidate.gait(gait), at_s=self.change_s),),
        )
        return SimTrial(
            robot=self.robot,
            plan=plan,
            failure=None,
            world=self.world,
            seed=self.number,
            events=[parse_failure_event(f"{text}@{at_s:.2f}") for text in case.failures],
        )

    @property
    def fingerprint(self) -> str:
        """Digest of all that decides a walk beside its case, 16 hexadecimal digits."""
        identity = {
            "robot": self.robot.fingerprint,
            "world": self.world.model_dump(mode="json"),
            "seed": self.number,
            "family": self.family,
            "code": _versions(),
        }
        return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:16]


@dataclass(frozen=True, slots=True, kw_only=True)
class CandidateWalk:
    """The outcome of one walk; NaN where it is not known.

    Attributes:
        case: what failed, and how the robot walked on.
        status: as in `hexctl.control.trial_result.STATUSES`.
        speed: along the line while it was measured, as a share of what was commanded before the failure; NaN
            for a walk that did not end on its feet.
        cost: of transport of the whole walk.
    """

    case: RepertoireCase
    status: str
    speed: float
    cost: float

    @classmethod
    def of(
        cls, conditions: RepertoireConditions, case: RepertoireCase, trial: SimTrial, result: TrialResult
    ) -> "CandidateWalk":
        """Walk of a case from its trial and the result."""
        gait, ended = trial.plan.gait, result.status in ENDED
        speed_m_s = Track.of(result, gait).speed(*conditions.measured_s) if ended else math.nan
        cost = result.cost_of_transport if ended else None
        return cls(
            case=case,
            status=result.status,
            speed=float(speed_m_s / ideal_speed_m_s(trial.robot, gait, trial.plan.motion(0.0))),
            cost=math.nan if cost is None else float(cost),
        )

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "CandidateWalk":
        """Walk of its values in a file; raises ValueError for what no simulation gives."""
        case = values["case"]
        candidate = Candidate.from_dict(case["candidate"])
        known = case | {"failures": tuple(case["failures"]), "candidate": candidate}
        walk = cls(**values | {"case": RepertoireCase(**known)})
        if walk.status not in STATUSES or math.isfinite(walk.speed) != (walk.status in ENDED):
            raise ValueError("it has values that no simulation gives")
        return walk


def walk_cases(
    conditions: RepertoireConditions, cases: Sequence[RepertoireCase], threads: int = 1
) -> list[CandidateWalk]:
    """Walks of some cases in one world, stepped together."""
    trials = [conditions.trial(case) for case in cases]
    results = run_sim_trials(trials, threads)
    return [
        CandidateWalk.of(conditions, case, trial, result)
        for case, trial, result in zip(cases, trials, results, strict=True)
    ]


def repertoire_cache(
    landscapes: LandscapeCache,
) -> WalkCache[RepertoireConditions, RepertoireCase, CandidateWalk]:
    """Walks on disk, a file for each robot and world, beside the landscapes of priors."""
    return WalkCache(landscapes, name="repertoire", read=CandidateWalk.from_dict)


@cache
def _versions() -> dict[str, str]:
    return code_versions() | {"source": source_digest(__name__)}
