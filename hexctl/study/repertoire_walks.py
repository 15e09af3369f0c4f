"""The walks of a repertoire: a failure, a change to a candidate, and the speed after it."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal
from zlib import crc32

import numpy as np

from hexctl.control.batch import SimTrial
from hexctl.control.monitor.repertoire import INTACT_GAIT, Candidate
from hexctl.control.trial_plan import GaitChange
from hexctl.control.trial_result import STATUSES, TrialResult
from hexctl.gait.gait import ideal_speed_m_s, make_gait
from hexctl.robot.failure_grammar import parse_failure_event
from hexctl.robot.model import Robot
from hexctl.runs.run_spec import RunSpec
from hexctl.runs.walk_plan import plan_walk
from hexctl.study.held_out import HeldOutPlace
from hexctl.study.recovery.episodes import Track
from hexctl.study.walk_cache import ENDED, known

#: Situations whose walks are simulated together in a world.
TOGETHER = 8

#: When the gait changes, and the failure comes before it at the latest and the earliest, in cycles.
CHANGE_CYCLES, ALARM_CYCLES, PHASES_CYCLES = 2.6, 0.4, 1.0

#: Delay from the change to the measurement of the speed, and its duration, in cycles.
SETTLES_CYCLES, MEASURED_CYCLES = 2.0, 3.0


def change_s(robot: Robot) -> float:
    """Return the time at which a robot changes its gait."""
    return round(CHANGE_CYCLES / robot.gait.pace_hz, 2)


def measured_s(robot: Robot) -> tuple[float, float]:
    """Return the beginning and the end of the time in which the speed is measured; the walk ends then."""
    first_s = change_s(robot) + SETTLES_CYCLES / robot.gait.pace_hz
    return first_s, first_s + MEASURED_CYCLES / robot.gait.pace_hz


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class RepertoireCase:
    """One walk under some conditions.

    Attributes:
        failures: leg and failure of each, such as `5:stuck:femur`.
    """

    failures: tuple[str, ...]
    heading_deg: float
    candidate: Candidate


@dataclass(frozen=True, slots=True, kw_only=True)
class CandidateWalk:
    """The outcome of one walk; NaN if not known.

    Attributes:
        speed: along the line while it was measured, as a share of the speed commanded before the failure; NaN
            for a walk that did not end on its feet.
        cost: cost of transport of the complete walk.
    """

    case: RepertoireCase
    status: Literal[STATUSES]  # type: ignore[valid-type]
    speed: float
    cost: float

    @classmethod
    def of(cls, case: RepertoireCase, trial: SimTrial, result: TrialResult) -> "CandidateWalk":
        """Return the walk of a case from its trial and the result."""
        gait, ended = trial.plan.gait, result.status in ENDED
        speed_m_s = Track.of(result, gait).speed(*measured_s(trial.robot)) if ended else math.nan
        return cls(
            case=case,
            status=result.status,
            speed=float(speed_m_s / ideal_speed_m_s(trial.robot, gait, trial.plan.motion(0.0))),
            cost=known(result.cost_of_transport if ended else None),
        )


@dataclass(frozen=True, kw_only=True)
class RepertoirePlace(HeldOutPlace[RepertoireCase, CandidateWalk]):
    """A robot in a world."""

    WALK: ClassVar[type[CandidateWalk]] = CandidateWalk
    KIND: ClassVar[str] = "repertoire"

    def settings(self) -> dict[str, Any]:
        """Settings that decide a walk; the family draws the phase of the failure."""
        return super().settings() | {"family": self.family}

    def chunks(self, cases: Sequence[RepertoireCase]) -> Iterator[tuple[RepertoireCase, ...]]:
        """Divide cases by situation, `TOGETHER` situations at a time."""
        situations = list(dict.fromkeys((case.failures, case.heading_deg) for case in cases))
        for first in range(0, len(situations), TOGETHER):
            some = situations[first : first + TOGETHER]
            yield tuple(case for case in cases if (case.failures, case.heading_deg) in some)

    def trial(self, case: RepertoireCase) -> SimTrial:
        """Trial of a case: the failure comes at a random phase, and the gait changes an alarm later."""
        gait = make_gait(self.robot, INTACT_GAIT)
        text = f"{self.family} {case.failures} {case.heading_deg:g}"
        share = np.random.default_rng([self.number, crc32(text.encode())]).uniform()
        before_s = (ALARM_CYCLES + PHASES_CYCLES * share) / gait.pace_hz
        change_at_s = change_s(self.robot)
        at_s = change_at_s - before_s
        walk = RunSpec(
            gait=gait,
            heading_rad=math.radians(case.heading_deg),
            duration_s=measured_s(self.robot)[1],
            self_rotation="none",
            hold="line",
            then=(GaitChange(gait=case.candidate.gait(gait), at_s=change_at_s),),
        )
        return SimTrial(
            robot=self.robot,
            plan=plan_walk(walk, self.robot),
            failures=None,
            world=self.world,
            seed=self.number,
            events=[parse_failure_event(f"{text}@{at_s:.2f}") for text in case.failures],
        )
