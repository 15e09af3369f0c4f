"""Walks of freely shaped gaits in open loop, and searches among them by trials on the failed robot.

A shape gives each leg a phase, a stroke, a height of its steps and a swing share. "Intelligent Trial and
Error" has amplitude, phase and duty factor of each servo instead.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from hexctl.control.batch import SimTrial, run_sim_trials
from hexctl.control.controllers import joints_of_feet
from hexctl.control.preparation import WalkStart
from hexctl.control.trial_result import TrialResult
from hexctl.control.walks.steered_walk import SteeredWalk
from hexctl.control.walks.steering import possible_hold
from hexctl.gait.foot_trajectory import StepPattern, feet_at_phases, part_of_cycle
from hexctl.gait.gait import Gait
from hexctl.study.recovery.open_loop import Rehearsal
from hexctl.study.walk_cache import ENDED
from hexctl.types import N_LEGS, FloatArray, RobotState

#: Lowest and highest phase in cycles, stroke and height as multiples of the gait's, and swing share.
LOW, HIGH = np.array([0.0, 0.0, 0.0, 0.1]), np.array([1.0, 1.5, 2.0, 0.6])

#: Length of a trial, and of the change from the walk before the failure.
TRIAL_S, CHANGE_S = 6.0, 1.0

#: Score of a trial that fell.
FELL = -1.0


def shape_of(gait: Gait) -> FloatArray:
    """Shape of a gait, (6, 4), each number 0 to 1 within `LOW` and `HIGH`."""
    ones = np.ones(N_LEGS)
    values = np.stack([gait.leg_phases, ones, ones, gait.swing_share * ones], axis=-1)
    return np.asarray((values - LOW) / (HIGH - LOW))


class ShapedWalk(SteeredWalk):
    """Walks of a batch along their lines until they learn of a failure, then in open loop with their shapes.

    Args:
        failure_s: time at which each learns of it; infinity for never.
        shapes: of the walks, (n, 6, 4) in 0 to 1.
    """

    def __init__(self, start: WalkStart, *, hold: str, failure_s: FloatArray, shapes: FloatArray) -> None:
        super().__init__(start, hold=hold)
        self._failure_s = failure_s
        pattern, values = self._pattern, LOW + (HIGH - LOW) * shapes
        height_m = pattern.height_m * values[..., 2]
        self._shaped = StepPattern(
            phases=values[..., 0],
            pace_hz=pattern.pace_hz,
            amplitude_m=pattern.amplitude_m,
            height_m=height_m,
            posture_m=np.zeros((*height_m.shape, 3)),
            stepping=np.ones_like(height_m),
            swing_share=values[..., 3],
        )
        headings_rad = [motion.heading_rad for motion in start.motions]
        way = -np.stack([np.cos(headings_rad), np.sin(headings_rad)], axis=-1)
        stroke_m = pattern.amplitude_m[..., np.newaxis] * values[..., 1]
        self._shaped_strokes = stroke_m[..., np.newaxis] * way[..., np.newaxis, :]

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        """Joint angles at this step, (n, 18)."""
        line_rad = super().targets_rad(step, state)
        since_s = (step + 0.5) * self._period_s - self._failure_s
        share = np.clip(since_s / CHANGE_S, 0.0, 1.0)[..., np.newaxis]
        u = part_of_cycle(self._shaped.pace_hz[..., np.newaxis] * step * self._period_s + self._shaped.phases)
        feet = feet_at_phases(self._robot, self._shaped, u, self._shaped_strokes, 1.0)
        return np.asarray(line_rad + share * (joints_of_feet(self._robot, feet) - line_rad))


class ShapeSearch(ABC):
    """Finds a shape by trials; scores are progress as a share of the commanded one, higher is better."""

    @abstractmethod
    def ask(self) -> list[FloatArray]:
        """The next shapes to try, (6, 4) each; none at the end."""

    @abstractmethod
    def tell(self, scores: FloatArray) -> None:
        """Take the scores of the last shapes."""


def shaped_walk(
    start: WalkStart, failure_s: FloatArray, rehearsals: Sequence[Rehearsal[FloatArray] | None]
) -> ShapedWalk:
    """Walks that change to the shapes that trials have found."""
    pairs = zip(start.plans, rehearsals, strict=True)
    shapes = np.stack([shape_of(plan.gait) if one is None else one.best for plan, one in pairs])
    return ShapedWalk(
        start, hold=possible_hold(start.plans[0], start.frame), failure_s=failure_s, shapes=shapes
    )


def search_shapes(
    search_of: Callable[[SimTrial], ShapeSearch], trials: Sequence[SimTrial], threads: int = 1
) -> list[Rehearsal[FloatArray] | None]:
    """Best shapes for walks in which legs fail; None for the others.

    In a trial the legs have failed from its first step on.
    """
    searches = {index: search_of(trial) for index, trial in enumerate(trials) if trial.events}
    tried: dict[int, list[tuple[float, FloatArray]]] = {index: [] for index in searches}
    while asked := [(index, shape) for index, search in searches.items() for shape in search.ask()]:
        scores = scores_of([(trial_of(trials[index]), shape) for index, shape in asked], threads)
        for index, search in searches.items():
            told = [(score, shape) for score, (one, shape) in zip(scores, asked, strict=True) if one == index]
            if told:
                tried[index] += told
                search.tell(np.array([score for score, _ in told]))
    return [
        Rehearsal(best=max(tried[index], key=lambda one: one[0])[1], trials=len(tried[index]))
        if index in tried
        else None
        for index in range(len(trials))
    ]


def trial_of(trial: SimTrial) -> SimTrial:
    """A trial of a shape for a walk, in its world and direction."""
    events = tuple(replace(event, at_s=0.0) for event in trial.events if event.failure is not None)
    return replace(trial, plan=replace(trial.plan, duration_s=TRIAL_S), events=events)


def scores_of(tried: Sequence[tuple[SimTrial, FloatArray]], threads: int = 1) -> list[float]:
    """Scores of trials of shapes, as the robot measures its progress."""
    trials = [replace(trial, plan=replace(trial.plan)) for trial, _ in tried]  # told apart by their plans
    shapes = {id(trial.plan): shape for trial, (_, shape) in zip(trials, tried, strict=True)}

    def make(start: WalkStart) -> ShapedWalk:
        own = np.stack([shapes[id(plan)] for plan in start.plans])
        return ShapedWalk(start, hold="line", failure_s=np.zeros(len(own)), shapes=own)

    return [score_of(result) for result in run_sim_trials(trials, threads, make, apart=True)]


def score_of(result: TrialResult) -> float:
    """Progress as a share of the commanded one; `FELL` for a robot that did not stay on its feet."""
    stands = result.status in ENDED and result.distance_m is not None
    return result.distance_m / result.ideal_distance_m if stands and result.distance_m else FELL
