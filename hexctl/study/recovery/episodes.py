"""Episodes of the recovery benchmark: walks in which legs fail, their places and outcomes."""

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from hexctl.control.batch import SimTrial, run_sim_trial, run_sim_trials
from hexctl.control.controllers import Controller
from hexctl.control.custom_controller import StepFunction
from hexctl.control.monitor.repertoire import find_repertoire
from hexctl.control.preparation import WalkStart
from hexctl.control.trial_result import STATUSES, TrialResult
from hexctl.gait.gait import AUTO, Gait, ideal_speed_m_s
from hexctl.learning.policy import KIND as POLICY
from hexctl.learning.policy import policy_file
from hexctl.robot.failure import FailureEvent
from hexctl.robot.failure_grammar import parse_failure_event
from hexctl.runs.run_spec import RunSpec
from hexctl.runs.walk_plan import plan_walk
from hexctl.study.held_out import HeldOutPlace
from hexctl.study.recovery.methods import METHODS, Alarm, method_of
from hexctl.study.recovery.trial_and_error import KIND as BEHAVIOURS
from hexctl.study.recovery.trial_and_error import behaviours_file
from hexctl.study.walk_cache import ENDED
from hexctl.types import ArrayFields, FloatArray

#: The gait that stands safest on six legs.
AUTO_GAIT = "auto"

#: The later speed is measured from this time after the failure on.
LATER_S = 5.0

#: HexaHeal's rule: a walk has recovered if it has this share of the commanded speed over its last seconds.
RULE_SHARE, RULE_S = 0.5, 8.0


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class RecoveryCase:
    """One walk under some conditions.

    Attributes:
        legs: those that fail, all in the same way, in this order; none in an intact walk.
        failure: as `parse_kind` reads it; `intact` without any.
        at_s: time of the first failure, since the walk began; in an intact walk the start of the comparison.
        method: as `method_of` reads it.
        apart_s: time from one leg's failure to that of the next.
    """

    gait: str
    legs: tuple[int, ...]
    failure: str
    at_s: float
    heading_deg: float
    method: str
    apart_s: float = 0.0

    @property
    def events(self) -> tuple[FailureEvent, ...]:
        """What the world does."""
        return tuple(
            parse_failure_event(f"{leg}:{self.failure}@{self.at_s + place * self.apart_s:.2f}")
            for place, leg in enumerate(self.legs)
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Episode:
    """The outcome of one walk, by the simulation's true pose; NaN if it is not known.

    Attributes:
        why: why it was stopped, or the likely cause of a walk without progress; None for neither.
        ideal_m_s: commanded speed before the failure.
        signed_m: deviation from the original line at the end, positive to the left.
        way_m: maximum absolute deviation after the failure.
        after_m_s: speed from `LATER_S` after the failure on.
        last_m_s: speed over the last `RULE_S`.
        trials: trials that its method made before the walk, to find out how to walk.
    """

    case: RecoveryCase
    status: Literal[STATUSES]  # type: ignore[valid-type]
    why: str | None
    duration_s: float
    alarms: tuple[Alarm, ...]
    pace_hz: float
    ideal_m_s: float
    signed_m: float
    way_m: float
    after_m_s: float
    last_m_s: float
    trials: int = 0

    @property
    def ended(self) -> bool:
        """Whether it ended on its feet."""
        return self.status in ENDED

    @property
    def final_m(self) -> float:
        """Final deviation in m; NaN for a walk that did not end on its feet."""
        return abs(self.signed_m) if self.ended else math.nan

    @property
    def early(self) -> tuple[Alarm, ...]:
        """Alarms before anything has failed: of an intact walk all."""
        return tuple(one for one in self.alarms if not self.case.legs or one.at_s < self.case.at_s)

    @property
    def delay_s(self) -> float:
        """Time from the failure to the first alarm after it; NaN without one."""
        later = [one.at_s for one in self.alarms if self.case.legs and one.at_s >= self.case.at_s]
        return later[0] - self.case.at_s if later else math.nan

    @property
    def right_leg(self) -> bool:
        """Whether the first alarm of the walk names a failed leg, after its failure."""
        if not self.alarms:
            return False
        first = self.alarms[0]
        return any(event.leg == first.leg and event.at_s <= first.at_s for event in self.case.events)

    @property
    def right_kind(self) -> bool:
        """Whether the first alarm has leg, kind and joint right."""
        if not self.right_leg:
            return False
        first = self.alarms[0]
        failures = [event.failure for event in self.case.events if event.leg == first.leg]
        return any(one and (one.kind, one.joint) == (first.kind, first.joint) for one in failures)

    @property
    def recovered(self) -> bool:
        """Whether it has recovered by HexaHeal's rule: no fall, and enough speed at its end."""
        return self.ended and self.last_m_s >= RULE_SHARE * self.ideal_m_s

    @classmethod
    def of(cls, case: RecoveryCase, trial: SimTrial, result: TrialResult, *, trials: int = 0) -> "Episode":
        """Episode of a case from its trial and the result, with the number of trials made before."""
        gait, at_s = trial.plan.gait, case.at_s
        track = Track.of(result, gait)
        ended = result.status in ENDED
        off_m = math.nan if not ended else float(track.path_m[-1, 1])
        end_s = result.duration_s
        return cls(
            case=case,
            status=result.status,
            why=result.stopped or result.cause,
            duration_s=float(end_s),
            alarms=tuple(Alarm.of(one) for one in result.noticed if not one.healed),
            pace_hz=float(gait.pace_hz),
            ideal_m_s=float(ideal_speed_m_s(trial.robot, gait, trial.plan.motion(0.0))),
            signed_m=off_m,
            way_m=track.most_off_m(at_s),
            after_m_s=track.speed(at_s + LATER_S, end_s) if ended else math.nan,
            last_m_s=track.speed(end_s - RULE_S, end_s) if ended else math.nan,
            trials=trials,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Track(ArrayFields):
    """Where a walk was at each tick: progress and deviation in m, (T, 2), with the tick and a cycle in s."""

    path_m: FloatArray
    period_s: float
    cycle_s: float

    @classmethod
    def of(cls, result: TrialResult, gait: Gait) -> "Track":
        """Track of a simulated walk with a gait; empty if there is none."""
        path_m = np.zeros((0, 2)) if result.true_path_m is None else result.true_path_m
        return cls(path_m, result.duration_s / max(1, len(path_m)), 1 / gait.pace_hz)

    def _row(self, time_s: float) -> int:
        return round(time_s / self.period_s) if len(self.path_m) else 0

    def speed(self, from_s: float, until_s: float) -> float:
        """Mean speed along the line in m/s; NaN unless at least half a cycle of that time was walked."""
        first, last = max(0, self._row(from_s)), min(self._row(until_s), len(self.path_m) - 1)
        if last <= first or (last - first) * self.period_s < self.cycle_s / 2:
            return math.nan
        return float(self.path_m[last, 0] - self.path_m[first, 0]) / ((last - first) * self.period_s)

    def most_off_m(self, from_s: float) -> float:
        """Maximum absolute deviation from a time on."""
        rows = self.path_m[self._row(from_s) :, 1]
        return float(np.abs(rows).max()) if rows.size else math.nan


@dataclass(frozen=True, kw_only=True)
class RecoveryPlace(HeldOutPlace[RecoveryCase, Episode]):
    """A robot in a world, under a protocol."""

    WALK: ClassVar[type[Episode]] = Episode
    KIND: ClassVar[str] = "recovery"

    protocol: str
    duration_s: float

    @property
    def title(self) -> str:
        """Name for progress and messages."""
        return f"{self.robot.name}, {self.protocol}, {self.family}:{self.number} ({self.kind})"

    def settings(self) -> dict[str, Any]:
        """Settings that decide a walk, with what was learned before for the robot."""
        plan = plan_walk(RunSpec(hold="line"), self.robot)
        repertoire = find_repertoire(self.robot, plan)
        digest = None if repertoire is None else repertoire.digest
        learned = {
            "repertoire": digest,
            "policy": POLICY.digest(policy_file(self.robot)),
            "behaviours": BEHAVIOURS.digest(behaviours_file(self.robot)),
        }
        return super().settings() | {"duration_s": self.duration_s} | learned

    def columns(self) -> dict[str, Any]:
        """Values of each row of this place."""
        return {"protocol": self.protocol} | super().columns()

    def row(self, walk: Episode) -> dict[str, Any]:
        """Values of the row of a walk, with what follows from its alarms."""
        names = ("ended", "final_m", "delay_s", "right_leg", "right_kind", "recovered")
        return (
            super().row(walk)
            | {name: getattr(walk, name) for name in names}
            | {
                "delay_cycles": walk.delay_s * walk.pace_hz,
                "early_alarms": len(walk.early),
                "fell": walk.status == "fell",
            }
        )

    def chunk_of(self, case: RecoveryCase) -> Hashable:
        """Walks by one method are simulated together; those with trials of their own are fewer."""
        return case.method, case.gait, case.legs if method_of(case.method).makes_trials else ()

    def keeps(self, walk: Episode) -> bool:
        """Walks by custom methods are never saved: their code may change."""
        return walk.case.method in METHODS

    def trial(self, case: RecoveryCase) -> SimTrial:
        """Return the trial of a case; methods distinguish walks by the identity of their plans."""
        walk = RunSpec(
            gait=AUTO if case.gait == AUTO_GAIT else case.gait,
            heading_rad=math.radians(case.heading_deg),
            duration_s=self.duration_s,
            self_rotation="none",
            hold="line",
        )
        return SimTrial(
            robot=self.robot,
            plan=plan_walk(walk, self.robot),
            failures=None,
            world=self.world,
            seed=self.number,
            events=case.events,
        )

    def walk(self, cases: Sequence[RecoveryCase], threads: int = 1) -> list[Episode]:
        """Simulate some cases of one method together."""
        trials = [self.trial(case) for case in cases]
        method = method_of(cases[0].method).prepared(trials, threads)
        to_come = {id(trial.plan): trial.events for trial in trials}

        def make(start: WalkStart) -> Controller | StepFunction:
            return method.controller(start, [to_come[id(plan)] for plan in start.plans])

        results = (
            [run_sim_trial(trial, make) for trial in trials]
            if method.alone
            else run_sim_trials(trials, threads, make, apart=True)
        )
        return [
            Episode.of(case, trial, result, trials=method.trials_before(trial.plan))
            for case, trial, result in zip(cases, trials, results, strict=True)
        ]
