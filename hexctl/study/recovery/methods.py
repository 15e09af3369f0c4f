"""The compared methods: reactions of robots to failures during a walk."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from typing import Generic

import numpy as np

from hexctl.control.batch import SimTrial
from hexctl.control.controllers import Controller
from hexctl.control.custom_controller import StepFunction
from hexctl.control.monitor.monitored_walk import recovering_walk
from hexctl.control.monitor.recovery import GlideToStableGait, Recovery, Response, WalkOn
from hexctl.control.preparation import WalkStart
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.walks.steered_walk import SteeredWalk
from hexctl.control.walks.steering import possible_hold
from hexctl.control.walks.velocity_walk import MotionWalk, VelocityWalk
from hexctl.learning.learned_walk import LearnedWalk
from hexctl.learning.policy import policy_of
from hexctl.robot.failure import Failure, FailureEvent, NoticedFailure, in_words
from hexctl.robot.plugins import made_of
from hexctl.study.recovery.decentralised import DecentralisedWalk
from hexctl.study.recovery.evolution import EvolutionSearch
from hexctl.study.recovery.open_loop import BestT, OpenLoopFromFailure, Rehearsal, rehearse
from hexctl.study.recovery.shaped_walk import ShapeSearch, search_shapes, shape_of, shaped_walk
from hexctl.study.recovery.stop_and_diagnose import StopAndDiagnoseWalk
from hexctl.study.recovery.trial_and_error import search_of_behaviours
from hexctl.types import BoolArray, FloatArray, RobotState


@dataclass(frozen=True, slots=True, kw_only=True)
class Alarm:
    """A failure that a walk has noticed.

    Attributes:
        at_s: time since the walk began.
        leg: accused leg, 1..6.
        joint: the failed joint; None for the entire leg.
    """

    at_s: float
    leg: int
    kind: str
    joint: str | None
    evidence: str

    @classmethod
    def of(cls, noticed: NoticedFailure) -> "Alarm":
        """Alarm of what a walk has noticed."""
        failure = noticed.failure
        return cls(
            at_s=round(float(noticed.at_s), 6),
            leg=failure.leg,
            kind=failure.kind,
            joint=failure.joint,
            evidence=noticed.evidence,
        )


class RecoveryMethod(ABC):
    """Reaction of a robot to failures. One method leads any number of walks, in several threads.

    Custom methods are subclasses with a constructor without arguments, named `package.module:Class`.

    Attributes:
        notices: whether its walks report what they notice (`Controller.noticed_failures`).
        makes_trials: whether it makes trials before its walks.
        alone: whether its controllers lead single robots, not batches.
    """

    notices = False
    makes_trials = False
    alone = False

    def prepared(self, trials: Sequence[SimTrial], threads: int = 1) -> "RecoveryMethod":
        """Return the method with the results of trials in the worlds of some walks; itself without trials.

        Args:
            trials: the walks; each needs its own plan object.
        """
        return self

    def trials_before(self, plan: TrialPlan) -> int:
        """Return the number of trials before the walk of a plan."""
        return 0

    @abstractmethod
    def controller(
        self, start: WalkStart, to_come: Sequence[Sequence[FailureEvent]]
    ) -> Controller | StepFunction:
        """Controller of a batch of walks, or a function of step and state that returns joint angles.

        Args:
            to_come: coming failures of each robot; a method that claims to notice must not read them.
        """


@dataclass(frozen=True, kw_only=True)
class ControllerMethod(RecoveryMethod):
    """Walks led by a controller that needs no trials before.

    Attributes:
        make: returns the controller of a batch of walks, of its start and the coming failures of each robot.
        notices: whether the controller reports the failures that it detects.
        alone: whether the controller leads one robot, not a batch.
    """

    make: Callable[[WalkStart, Sequence[Sequence[FailureEvent]]], Controller]
    notices: bool = False
    alone: bool = False

    def controller(self, start: WalkStart, to_come: Sequence[Sequence[FailureEvent]]) -> Controller:
        """Controller of a batch of walks, which `make` returns."""
        return self.make(start, to_come)


@dataclass(frozen=True, kw_only=True, eq=False)
class ByTrials(RecoveryMethod, Generic[BestT]):
    """Continues after the failure in open loop, as trials have found.

    Attributes:
        rehearse: returns what trials of each walk have found; None without a failure.
        walk: makes the controller from what was found for each, and when each learns of its failure.
        rehearsals: what trials have found, by the `id` of the walk's plan.
    """

    rehearse: Callable[[Sequence[SimTrial], int], Sequence[Rehearsal[BestT] | None]]
    walk: Callable[[WalkStart, FloatArray, Sequence[Rehearsal[BestT] | None]], Controller]
    rehearsals: Mapping[int, Rehearsal[BestT]] = field(default_factory=dict)

    makes_trials = True

    def prepared(self, trials: Sequence[SimTrial], threads: int = 1) -> RecoveryMethod:
        """The method with what trials of these walks have found."""
        pairs = zip(trials, self.rehearse(trials, threads), strict=True)
        return replace(self, rehearsals={id(trial.plan): each for trial, each in pairs if each is not None})

    def trials_before(self, plan: TrialPlan) -> int:
        """Number of trials for a walk."""
        return self.rehearsals[id(plan)].trials if id(plan) in self.rehearsals else 0

    def controller(self, start: WalkStart, to_come: Sequence[Sequence[FailureEvent]]) -> Controller:
        """Walks with knowledge of the future failures and what to do then."""
        failure_s = np.array([min((event.at_s for event in events), default=math.inf) for events in to_come])
        return self.walk(start, failure_s, [self.rehearsals.get(id(plan)) for plan in start.plans])


def by_shapes(search: Callable[[SimTrial], ShapeSearch]) -> ByTrials[FloatArray]:
    """Continues with the shape that a search by trials has found."""
    return ByTrials(rehearse=partial(search_shapes, search), walk=shaped_walk)


def watched(recovery: Recovery) -> ControllerMethod:
    """Walks with a monitor, and a recovery for the failures it finds."""
    make = recovering_walk(recovery)
    return ControllerMethod(make=lambda start, _: make(start), notices=True)


def stopping(recovery: Recovery) -> ControllerMethod:
    """Stops at the monitor's alarm, makes the standing test, and continues with its result."""
    return ControllerMethod(
        make=lambda start, _: StopAndDiagnoseWalk(start, recovery), notices=True, alone=True
    )


class OracleWalk(Controller):
    """Walks of a batch by an oracle: each learns leg and kind in the tick of the failure.

    Args:
        to_come: failures of each robot; those of one moment get one response.
    """

    def __init__(
        self, start: WalkStart, to_come: Sequence[Sequence[FailureEvent]], recovery: Recovery
    ) -> None:
        self.hold = possible_hold(start.plans[0], start.frame)
        self.walk: VelocityWalk = (
            MotionWalk(start) if self.hold == "none" else SteeredWalk(start, hold=self.hold)
        )
        self.walk.leave_plain()  # walks change their gaits at different times
        self._start, self._recovery = start, recovery
        self._headings_rad = [motion.heading_rad for motion in start.motions]
        for plan, heading_rad in zip(start.plans, self._headings_rad, strict=True):
            recovery.prepare(start.robot, plan, heading_rad)
        self._to_come = [list(events) for events in to_come]
        self._failures: list[dict[int, Failure]] = [{} for _ in start.plans]
        self._stopped: dict[int, str] = {}

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        """Joint angles at this step, (n, 18)."""
        learned = np.zeros(len(self._to_come), dtype=bool)
        gaits = list(self.walk.gaits)
        for index, events in enumerate(self._to_come):
            now = [event for event in events if event.at_s <= (step + 0.5) * self._start.period_s]
            if now:
                del events[: len(now)]
                response = self._response(index, now)
                if response.gait is not None:
                    gaits[index], learned[index] = response.gait, True
        if learned.any():
            self.walk.glide_to(gaits, learned)
        self.limited_steps = self.walk.limited_steps
        return self.walk.targets_rad(step, state)

    def done(self, step: int, state: RobotState) -> BoolArray:
        """Whether the recovery has stopped each walk, (n,)."""
        return np.array([index in self._stopped for index in range(len(self._to_come))])

    def why_stopped(self, index: int = 0) -> str | None:
        """The failures for which the recovery has stopped a walk, or None."""
        return self._stopped.get(index)

    def _response(self, index: int, now: Sequence[FailureEvent]) -> Response:
        known = self._failures[index]
        for event in now:
            if event.failure is None:
                known.pop(event.leg, None)
            else:
                known[event.leg] = event.failure
        plan, heading_rad = self._start.plans[index], self._headings_rad[index]
        response = self._recovery.respond(self._start.robot, plan, heading_rad, list(known.values()))
        if response.stop:
            failed = (f"leg {leg} {in_words(failure)}" for leg, failure in sorted(known.items()))
            self._stopped.setdefault(index, ", ".join(failed))
        return response


#: Methods by name.
METHODS: dict[str, Callable[[], RecoveryMethod]] = {
    # The monitor detects failures, and the gait stays as it is.
    "nothing": lambda: watched(WalkOn()),
    # An oracle knows leg and kind in the tick of the failure, then glides to the gait of `recover`.
    "told": lambda: ControllerMethod(make=partial(OracleWalk, recovery=GlideToStableGait())),
    # At the monitor's alarm the walk glides to a stable gait.
    "recover": lambda: watched(GlideToStableGait()),
    # At the monitor's alarm the robot stops, makes the standing test, and continues with its result.
    "stop-diagnose": lambda: stopping(GlideToStableGait()),
    # Knows no failures: each leg steps by its own load and that of its neighbours.
    "decentralised": lambda: ControllerMethod(make=lambda start, _: DecentralisedWalk(start)),
    # The paper's method: continues in open loop with the gait whose trial ended nearest the line.
    "open-loop-best": lambda: ByTrials(rehearse=rehearse, walk=OpenLoopFromFailure),
    # Knows no failures: a policy, trained in simulation with failing legs, moves the feet of the gait.
    "ppo": lambda: ControllerMethod(
        make=lambda start, _: LearnedWalk(
            start, policy_of(start.robot), hold=possible_hold(start.plans[0], start.frame)
        )
    ),
    # Intelligent trial and error: searches in an archive of gaits of the intact robot.
    "trial-and-error": lambda: by_shapes(search_of_behaviours),
    # CMA-ES, from the gait of the walk on; continues in open loop with the best shape.
    "cma-es": lambda: by_shapes(lambda trial: EvolutionSearch(shape_of(trial.plan.gait), trial.seed)),
}

#: Methods compared by default.
DEFAULT_METHODS = ("nothing", "told", "recover")

#: What the others are compared with.
NOTHING = "nothing"


@cache
def method_of(name: str) -> RecoveryMethod:
    """The method of a name of `METHODS`, or a custom one, `package.module:Class`.

    Raises InputError for anything else.
    """
    return made_of(name, METHODS, RecoveryMethod, "methods")  # type: ignore[type-abstract]
