"""Trials whose end an operator measures, on a robot without a position."""

import math
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from hexctl.backends.clock import PERIOD_S
from hexctl.control.scoring.score import progress_floor_m
from hexctl.control.scoring.walk_quality import cost_of_transport
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import Deviation, TrialResult
from hexctl.gait.foot_trajectory import RAMP_DURATION_S
from hexctl.robot.model import Robot
from hexctl.types import FloatArray

#: Reason of a trial that the operator did not measure; it is invalid.
SKIPPED = "skipped"


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """Answer of an operator about a walk.

    Attributes:
        word: `measured`; `fell`; `skip`: the trial is invalid; `again`: repeat the walk; `quit`: end.
        distance_m: progress along the line.
        signed_m: deviation from it, left positive.
        before_m: points of the path before its end, (distance, deviation) each, in their order.
    """

    word: Literal["measured", "fell", "skip", "again", "quit"]
    distance_m: float = math.nan
    signed_m: float = math.nan
    before_m: tuple[tuple[float, float], ...] = ()


class Operator(Protocol):
    """A person near the robot, or a program that answers for one."""

    def place(self, index: int, code: int) -> bool:
        """Place the robot on its mark before a trial; return False to end instead.

        A walk of the baseline has the index 0, and the code 0 if it has none.
        """

    def measure(self, index: int, *, at_most_m: float) -> Answer:
        """Measure a trial; numbers are at most `at_most_m`."""


def measured(result: TrialResult, answer: Answer, robot: Robot, plan: TrialPlan) -> TrialResult:
    """Result of a walk completed with an operator's answer; NaN if not measured."""
    if answer.word == "quit":
        return replace(result, status="aborted", stopped="requested")
    unknown = _path(result)
    bare = replace(result, distance_m=None, cost_of_transport=None, deviation=None, path_m=unknown)
    if answer.word == "fell":
        return replace(bare, status="fell")
    if answer.word != "measured":
        return replace(bare, status="cut_short", stopped=SKIPPED)
    distance_m, signed_m = answer.distance_m, answer.signed_m
    slow = result.duration_s >= RAMP_DURATION_S and distance_m < progress_floor_m(
        robot, plan, result.duration_s
    )
    return replace(
        bare,
        status="no_progress" if slow else "ok",
        distance_m=distance_m,
        cost_of_transport=cost_of_transport(robot, result.energy_j, distance_m),
        deviation=Deviation(abs(signed_m), math.nan, math.nan, signed_m),
        path_m=_path(result, *answer.before_m, (distance_m, signed_m)),
    )


def measured_by_tape(result: TrialResult, robot: Robot, plan: TrialPlan) -> TrialResult:
    """Result of a simulated walk of a robot without a position, whose end a person would measure."""
    if result.status != "ok" or result.true_path_m is None or "position" in robot.sensors:
        return result
    distance_m, signed_m = result.true_path_m[-1].tolist()
    return measured(result, Answer(word="measured", distance_m=distance_m, signed_m=signed_m), robot, plan)


def _path(result: TrialResult, *points_m: tuple[float, float]) -> FloatArray:
    """Path of which some points are known, (T, 2), at the ticks by which a steady walk has come so far."""
    path = np.full((max(1, round(result.duration_s / PERIOD_S)), 2), np.nan)
    if points_m:
        points = np.array(points_m)
        ways_m = np.hypot(*np.diff(points, axis=0, prepend=0.0).T).cumsum()
        lost = min(RAMP_DURATION_S / 2 / result.duration_s, 1.0)  # of the time, in the soft start
        share = lost + (1 - lost) * ways_m / max(float(ways_m[-1]), 1e-9)
        path[np.rint(share * len(path)).astype(int) - 1] = points
    return path
