"""Trials whose end an operator measures, on a robot that does not know its position."""

import math
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from hexctl.backends.clock import PERIOD_S
from hexctl.control.plan import TrialPlan
from hexctl.control.result import Deviation, TrialResult, progress_floor_m, score
from hexctl.gait.foot_trajectory import RAMP_DURATION_S
from hexctl.robot.model import Robot
from hexctl.types import FloatArray

#: Why a trial that nobody measured counts for nothing.
SKIPPED = "skipped"


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What a person says of a walk.

    Attributes:
        word: `measured`; `fell`; `skip`: this gait counts for nothing; `again`: forget it and walk it again;
            `quit`: forget it and end.
        distance_m: progress along the line, with `measured`.
        signed_m: deviation from it, left positive, with `measured`.
    """

    word: Literal["measured", "fell", "skip", "again", "quit"]
    distance_m: float = math.nan
    signed_m: float = math.nan


class Operator(Protocol):
    """Somebody beside the robot."""

    def place(self, index: int, code: int) -> bool:
        """Have the robot put on its mark before a trial; return False to end instead."""

    def measure(self, index: int, *, at_most_m: float) -> Answer:
        """Return what came of a trial; no number is larger than `at_most_m`."""


def measured(result: TrialResult, answer: Answer, robot: Robot, plan: TrialPlan) -> TrialResult:
    """Return the result of a walk with what a person says of it; what nobody measured is nan."""
    if answer.word == "quit":
        return replace(result, status="aborted", stopped="requested")
    unknown = _path(result, math.nan, math.nan)
    bare = replace(result, distance_m=None, deviation=None, path_m=unknown)
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
        deviation=Deviation(abs(signed_m), math.nan, math.nan, signed_m),
        path_m=_path(result, distance_m, signed_m),
    )


def not_walked(robot: Robot, plan: TrialPlan) -> TrialResult:
    """Return the result of a trial that a person did not let begin."""
    nowhere = np.zeros((0, 3)), np.zeros((0, 4))
    return score(
        robot,
        plan,
        status="aborted",
        stopped="requested",
        duration_s=0.0,
        turned_rad=0.0,
        clipped_ticks=0,
        frame=None,
        positions_world=nowhere[0],
        quaternions_world=nowhere[1],
    )


def _path(result: TrialResult, distance_m: float, signed_m: float) -> FloatArray:
    """Return a path of which only the end is known, (T, 2)."""
    path = np.full((max(1, round(result.duration_s / PERIOD_S)), 2), np.nan)
    path[-1] = distance_m, signed_m
    return path
