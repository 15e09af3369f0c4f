"""The compared methods: reactions of robots to failures during a walk."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from hexctl.control.batch import SimTrial
from hexctl.control.controllers import Controller
from hexctl.control.custom_controller import StepFunction
from hexctl.control.monitor.monitored_walk import recovering_walk
from hexctl.control.monitor.recovery import GlideToStableGait, RecoveryPolicy, Response, WalkOn
from hexctl.control.preparation import WalkStart
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.walks.steered_walk import SteeredWalk
from hexctl.control.walks.steering import held
from hexctl.control.walks.velocity_walk import MotionWalk, VelocityWalk
from hexctl.learning.learned_walk import LearnedWalk
from hexctl.learning.policy import policy_of
from hexctl.robot.failure import Failure, FailureEvent, NoticedFailure, in_words
from hexctl.robot.plugins import made_of
from hexctl.study.recovery.decentralised import DecentralisedWalk
from hexctl.study.recovery.evolution import EvolutionSearch
from hexctl.study.recovery.open_loop import OpenLoopFromFailure, Rehearsal, rehearse
from hexctl.study.recovery.shaped_walk import ShapedWalk, ShapeSearch, search_shapes, shape_of
from hexctl.study.recovery.stop_and_diagnose import StopAndDiagnoseWalk
from hexctl.study.recovery.trial_and_error import TrialAndErrorSearch, behaviours_of
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


class Monitored(RecoveryMethod):
    """Walks with a monitor, and a policy for the failures it finds."""

    notices = True

    def __init__(self, policy: RecoveryPolicy) -> None:
        self._make = recovering_walk(policy)

    def controller(self, start: WalkStart, to_come: Sequence[Sequence[FailureEvent]]) -> Controller:
        """Return the watched walks."""
        return self._make(start)


class Told(RecoveryMethod):
    """An oracle: it gets leg and kind in the tick of the failure, then glides to the gait of `recover`."""

    def __init__(self) -> None:
        self._policy = GlideToStableGait()

    def controller(self, start: WalkStart, to_come: Sequence[Sequence[FailureEvent]]) -> Controller:
        """Return walks with knowledge of the future failures."""
        return ToldWalk(start, self._policy, to_come)


class ToldWalk(Controller):
    """Walks of a batch that learn of each failure in its tick.

    Args:
        to_come: failures of each robot; those of one moment get one response.
    """

    def __init__(
        self, start: WalkStart, policy: RecoveryPolicy, to_come: Sequence[Sequence[FailureEvent]]
    ) -> None:
        self.hold = held(start.plans[0], start.frame)
        self.walk: VelocityWalk = (
            MotionWalk(start) if self.hold == "none" else SteeredWalk(start, hold=self.hold)
        )
        self.walk.leave_plain()  # walks change their gaits at different times
        self._start, self._policy = start, policy
        self._headings_rad = [motion.heading_rad for motion in start.motions]
        for plan, heading_rad in zip(start.plans, self._headings_rad, strict=True):
            policy.prepare(start.robot, plan, heading_rad)
        self._to_come = [list(events) for events in to_come]
        self._failures: list[dict[int, Failure]] = [{} for _ in start.plans]
        self._stopped: dict[int, str] = {}

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        """Joint angles at this step, (n, 18)."""
        told = np.zeros(len(self._to_come), dtype=bool)
        gaits = list(self.walk.gaits)
        for index, events in enumerate(self._to_come):
            now = [event for event in events if event.at_s <= (step + 0.5) * self._start.period_s]
            if now:
                del events[: len(now)]
                response = self._response(index, now)
                if response.gait is not None:
                    gaits[index], told[index] = response.gait, True
        if told.any():
            self.walk.glide_to(gaits, told)
        self.limited_steps = self.walk.limited_steps
        return self.walk.targets_rad(step, state)

    def done(self, step: int, state: RobotState) -> BoolArray:
        """Whether the policy has stopped each walk, (n,)."""
        return np.array([index in self._stopped for index in range(len(self._to_come))])

    def why_stopped(self, index: int = 0) -> str | None:
        """The failures for which the policy has stopped a walk, or None."""
        return self._stopped.get(index)

    def _response(self, index: int, now: Sequence[FailureEvent]) -> Response:
        known = self._failures[index]
        for event in now:
            if event.failure is None:
                known.pop(event.leg, None)
            else:
                known[event.leg] = event.failure
        plan, heading_rad = self._start.plans[index], self._headings_rad[index]
        response = self._policy.respond(self._start.robot, plan, heading_rad, list(known.values()))
        if response.stop:
            failed = (f"leg {leg} {in_words(failure)}" for leg, failure in sorted(known.items()))
            self._stopped.setdefault(index, ", ".join(failed))
        return response


class StopDiagnose(RecoveryMethod):
    """Stops at the monitor's alarm, makes the standing test, and continues with its result."""

    notices = alone = True

    def __init__(self) -> None:
        self._policy = GlideToStableGait()

    def controller(self, start: WalkStart, to_come: Sequence[Sequence[FailureEvent]]) -> Controller:
        """A walk that stops and goes."""
        return StopAndDiagnoseWalk(start, self._policy)


class ByTrials(RecoveryMethod):
    """Continues after the failure as trials have found.

    Args:
        found: what trials have found, by the `id` of the walk's plan.
    """

    makes_trials = True

    def __init__(self, found: Mapping[int, Rehearsal[Any]] | None = None) -> None:
        self._found = found or {}

    @abstractmethod
    def rehearsed(self, trials: Sequence[SimTrial], threads: int) -> Sequence[Rehearsal[Any] | None]:
        """What trials of each walk have found; None without a failure."""

    def prepared(self, trials: Sequence[SimTrial], threads: int = 1) -> RecoveryMethod:
        """The method with what trials of these walks have found."""
        pairs = zip(trials, self.rehearsed(trials, threads), strict=True)
        return type(self)({id(trial.plan): each for trial, each in pairs if each is not None})

    def trials_before(self, plan: TrialPlan) -> int:
        """Number of trials for a walk."""
        return self._found[id(plan)].trials if id(plan) in self._found else 0


class OpenLoopBest(ByTrials):
    """The paper's method: after the failure it walks in open loop with the gait that trials have found."""

    def rehearsed(self, trials: Sequence[SimTrial], threads: int) -> Sequence[Rehearsal[Any] | None]:
        """The gaits that ended nearest the lines."""
        return rehearse(trials, threads)

    def controller(self, start: WalkStart, to_come: Sequence[Sequence[FailureEvent]]) -> Controller:
        """Walks with knowledge of the future failures and their next gaits."""
        known = [self._found.get(id(plan)) for plan in start.plans]
        gaits = {index: each.best for index, each in enumerate(known) if each is not None}
        hold, told_s = held(start.plans[0], start.frame), first_times_s(to_come)
        return OpenLoopFromFailure(start, hold=hold, told_s=told_s, gaits=gaits)


class Decentralised(RecoveryMethod):
    """Has no belief about its legs: each steps by its own load and its neighbours'."""

    def controller(self, start: WalkStart, to_come: Sequence[Sequence[FailureEvent]]) -> Controller:
        """Walks with a phase for each leg."""
        return DecentralisedWalk(start, hold=held(start.plans[0], start.frame))


class Learned(RecoveryMethod):
    """A policy, trained in simulation with failing legs, moves the feet of the gait; it knows no failures."""

    def controller(self, start: WalkStart, to_come: Sequence[Sequence[FailureEvent]]) -> Controller:
        """Walks led by the shipped policy of their robot."""
        return LearnedWalk(start, policy_of(start.robot), hold=held(start.plans[0], start.frame))


class Shaped(ByTrials):
    """After the failure it continues in open loop with the shape that a search by trials has found."""

    @abstractmethod
    def search(self, trial: SimTrial) -> ShapeSearch:
        """A search for the walk of a trial."""

    def rehearsed(self, trials: Sequence[SimTrial], threads: int) -> Sequence[Rehearsal[Any] | None]:
        """The best shapes."""
        failing = [trial for trial in trials if trial.events]
        found = iter(search_shapes(failing, [self.search(trial) for trial in failing], threads))
        return [next(found) if trial.events else None for trial in trials]

    def controller(self, start: WalkStart, to_come: Sequence[Sequence[FailureEvent]]) -> Controller:
        """Walks with knowledge of the future failures and their next shapes."""
        known = [self._found.get(id(plan)) for plan in start.plans]
        shapes = [
            shape_of(plan.gait) if each is None else each.best
            for plan, each in zip(start.plans, known, strict=True)
        ]
        hold, told_s = held(start.plans[0], start.frame), np.array(first_times_s(to_come))
        return ShapedWalk(start, hold=hold, told_s=told_s, shapes=np.stack(shapes))


class TrialAndError(Shaped):
    """Intelligent trial and error: searches in an archive of gaits of the intact robot."""

    def search(self, trial: SimTrial) -> ShapeSearch:
        """A search in the archive, whose gaits all walk towards leg 1."""
        return TrialAndErrorSearch(behaviours_of(trial.robot).towards(trial.plan.heading_rad))


class Evolution(Shaped):
    """CMA-ES, which begins with the gait of the walk."""

    def search(self, trial: SimTrial) -> ShapeSearch:
        """A search from the walk's gait."""
        return EvolutionSearch(shape_of(trial.plan.gait), trial.seed)


def first_times_s(to_come: Sequence[Sequence[FailureEvent]]) -> list[float]:
    """Time of the first failure of each robot; infinity for none."""
    return [min((event.at_s for event in events), default=math.inf) for events in to_come]


#: Methods by name.
METHODS: dict[str, Callable[[], RecoveryMethod]] = {
    "nothing": lambda: Monitored(WalkOn()),
    "told": Told,
    "recover": lambda: Monitored(GlideToStableGait()),
    "stop-diagnose": StopDiagnose,
    "decentralised": Decentralised,
    "open-loop-best": OpenLoopBest,
    "ppo": Learned,
    "trial-and-error": TrialAndError,
    "cma-es": Evolution,
}

#: Methods compared by default.
DEFAULT_METHODS = ("nothing", "told", "recover")

#: What the others are compared with, and the oracle.
NOTHING, TOLD = "nothing", "told"


@cache
def method_of(name: str) -> RecoveryMethod:
    """The method of a name of `METHODS`, or a custom one, `package.module:Class`.

    Raises InputError for anything else.
    """
    return made_of(name, METHODS, RecoveryMethod, "methods")  # type: ignore[type-abstract]
