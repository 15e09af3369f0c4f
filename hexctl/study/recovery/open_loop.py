"""Walks in open loop after a failure, with the gait that trials have found to end nearest its line."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from hexctl.adapt.space import GaitSpace
from hexctl.control.batch import SimTrial, run_sim_trials
from hexctl.control.preparation import WalkStart
from hexctl.control.trial_result import TrialResult
from hexctl.control.walks.steered_walk import SteeredWalk
from hexctl.control.walks.steering import possible_hold
from hexctl.gait.gait import Gait, ideal_speed_m_s
from hexctl.types import BoolArray, FloatArray, RobotState

#: Number of tried gaits, as in the paper's searches.
TRIES = 40

#: Minimum duration of a trial.
LEAST_TRIAL_S = 10.0


BestT = TypeVar("BestT", Gait, FloatArray)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rehearsal(Generic[BestT]):
    """Best gait or shape for one walk, and the number of trials to find it."""

    best: BestT
    trials: int


def rehearse(trials: Sequence[SimTrial], threads: int = 1) -> list[Rehearsal[Gait] | None]:
    """Gaits of trials that ended nearest their lines, for walks in which legs fail; None for the others.

    `TRIES` gaits, or all if there are fewer, are tried once each, in open loop, in the same world and
    direction of travel, for the time that the walk has left after the first failure. All legs that fail in
    the walk have failed from the first step on. The seed of the world draws the gaits among all codes of the
    remaining legs. The end is judged as the robot measures it.
    """
    tried = [_tries_of(trial) for trial in trials]
    results = iter(run_sim_trials([one for each in tried for one in each], threads))
    found: list[Rehearsal[Gait] | None] = []
    for each in tried:
        ends = [(next(results), one) for one in each]
        best = min(ends, key=lambda pair: _badness(pair[0]))[1] if ends else None
        found.append(None if best is None else Rehearsal(best=best.plan.gait, trials=len(each)))
    return found


def _tries_of(trial: SimTrial) -> list[SimTrial]:
    failing = [event for event in trial.events if event.failure is not None]
    if not failing:
        return []
    space = GaitSpace(tuple(sorted({event.leg for event in failing})))
    codes = 1 + np.random.default_rng(trial.seed).permutation(space.size)[:TRIES]
    left_s = trial.plan.duration_s - min(event.at_s for event in failing)
    plan = replace(trial.plan, hold="none", duration_s=max(LEAST_TRIAL_S, left_s))
    events = tuple(replace(event, at_s=0.0) for event in failing)
    gaits = [replace(plan.gait, slots=space.slots_of(int(code))) for code in codes]
    return [replace(trial, plan=replace(plan, gait=gait), events=events) for gait in gaits]


def _badness(result: TrialResult) -> tuple[int, float]:
    """Order of trials: first those that progress on their feet, then by final deviation."""
    rank = {"ok": 0, "no_progress": 1}.get(result.status, 2)
    off_m = np.inf if result.deviation is None else result.deviation.final
    return rank, off_m if np.isfinite(off_m) else np.inf


class OpenLoopFromFailure(SteeredWalk):
    """Walks along its line until it learns of a failure, and from then on in open loop.

    Args:
        failure_s: time at which each learns of it; infinity for never.
        best: what trials have found for each.
    """

    def __init__(
        self, start: WalkStart, failure_s: FloatArray, best: Sequence[Rehearsal[Gait] | None]
    ) -> None:
        super().__init__(start, hold=possible_hold(start.plans[0], start.frame))
        self.leave_plain()  # walks change their gaits at different times
        self._failure_s, self._best, self._motions = failure_s, best, start.motions
        self._open: BoolArray = np.zeros(len(start.plans), dtype=bool)
        self._nominal: FloatArray = np.zeros((len(start.plans), 3))

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        """Joint angles at this step, (n, 18)."""
        now = ~self._open & (self._failure_s <= (step + 0.5) * self._period_s)
        if now.any():
            self._leave_line(now)
        return super().targets_rad(step, state)

    def desired(self, dt_s: float, step: int, state: RobotState) -> FloatArray:
        """Velocity of the law, or that of the gait if the loop is open, (n, 3)."""
        steered = super().desired(dt_s, step, state)
        return np.where(self._open[:, np.newaxis], self._nominal, steered)

    def _leave_line(self, which: BoolArray) -> None:
        self._open = self._open | which
        pairs = zip(self.gaits, self._best, strict=True)
        self.glide_to([gait if found is None else found.best for gait, found in pairs], which)
        for index in np.flatnonzero(which).tolist():
            motion = self._motions[index]
            speed_m_s = ideal_speed_m_s(self._robot, self.gaits[index], motion)
            way = np.cos(motion.heading_rad), np.sin(motion.heading_rad)
            self._nominal[index, :2] = speed_m_s * way[0], speed_m_s * way[1]
