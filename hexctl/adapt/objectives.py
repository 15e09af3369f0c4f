"""Objectives: scores of trials, to be minimized."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from hexctl.control.trial_result import Deviation, TrialResult
from hexctl.errors import InputError, argument, check_type
from hexctl.robot.plugins import load_custom
from hexctl.types import BoolArray, FloatArray

#: Score of a trial that fell, made no progress, diverged or was aborted: worse than any valid score.
INVALID_SCORE = 1e6

#: Scores of valid trials are limited to this, so that each is ahead of every invalid one.
WORST_VALID_SCORE = 0.99 * INVALID_SCORE


@dataclass(frozen=True, slots=True, kw_only=True)
class Objective:
    """A score of trials; smaller is better.

        slow = hexctl.Objective(name="slow", label="slowness", measure=lambda trial: -trial.distance_m)
        hexctl.adapt(failed_leg=5, objective=slow, budget=2, duration_s=3)

    Attributes:
        name: in `--objective` and sessions.
        label: for tables and figures.
        unit: of the score; empty if none or unknown.
        needs_course: whether the complete path of a walk counts, not only its end.
        needs_torques: whether the joint torques of the robot count.
        hold: default hold of the walks, one of `hexctl.control.trial_plan.HOLDS`; `none` if the deviation is
            searched.
    """

    name: str
    label: str
    measure: Callable[[TrialResult], float]
    unit: str = ""
    needs_course: bool = True
    needs_torques: bool = False
    hold: str = "none"

    def __call__(self, result: TrialResult) -> float:
        """Score of a trial: `INVALID_SCORE` for an invalid one, else at most `WORST_VALID_SCORE`.

        Raises InputError when the measure of a valid trial is not a finite number.
        """
        if not result.valid or result.distance_m is None:
            return INVALID_SCORE
        score = self.measure(result)
        try:
            number = float(score)
        except (TypeError, ValueError):
            number = math.nan
        if not math.isfinite(number):
            raise InputError(f"objective {self.name}: got the score {score!r}; allowed: a finite number")
        return min(number, WORST_VALID_SCORE)


def _deviation(result: TrialResult) -> Deviation:
    return result.deviation or Deviation(math.nan, math.nan, math.nan, math.nan)


def _progress(result: TrialResult) -> float:
    """Final deviation per share of the ideal distance: of equally straight walks the faster one is better."""
    # A walk shorter than the soft start is valid without progress.
    return _deviation(result).final * result.ideal_distance_m / max(result.distance_m or 0.0, 1e-9)


def _told(value: float | None, what: str) -> float:
    """A measured value; raises InputError if the robot did not measure it."""
    if value is None:
        raise InputError(
            f"{argument('objective')}: got a walk without {what}; allowed: of a robot that measures it"
        )
    return value


_SHIPPED = (
    Objective(
        name="final",
        label="deviation at the end",
        unit="m",
        needs_course=False,
        measure=lambda result: _deviation(result).final,  # the paper's F
    ),
    Objective(name="mean", label="mean deviation", unit="m", measure=lambda result: _deviation(result).mean),
    Objective(name="max", label="maximum deviation", unit="m", measure=lambda result: _deviation(result).max),
    Objective(
        name="progress",
        label="deviation at the end per share of the ideal distance",
        unit="m",
        needs_course=False,
        measure=_progress,
    ),
    Objective(
        name="speed",
        label="time per metre of progress",
        unit="s/m",
        needs_course=False,
        # Time per metre, to be minimized, with the soft start; limited as `_progress` is.
        measure=lambda result: result.duration_s / max(result.distance_m or 0.0, 1e-9),
        hold="auto",
    ),
    Objective(
        name="cost",
        label="cost of transport",
        needs_course=False,
        needs_torques=True,
        measure=lambda result: _told(result.cost_of_transport, "joint torques"),
        hold="auto",
    ),
    Objective(
        name="tilt",
        label="lean of the body, rms",
        unit="deg",
        measure=lambda result: _told(result.tilt_deg, "orientations"),
        hold="auto",
    ),
    Objective(
        name="steadiness",
        label="deviation of the velocity from its mean, rms",
        unit="m/s",
        measure=lambda result: _told(result.steadiness, "positions"),
        hold="auto",
    ),
)

#: The objectives that come with hexctl, by name.
OBJECTIVES: Mapping[str, Objective] = MappingProxyType({objective.name: objective for objective in _SHIPPED})


#: An objective as users name it: a name, an `Objective`, or a function of a valid trial.
ObjectiveChoice = str | Objective | Callable[[TrialResult], float]


def make_objective(name: str) -> Objective:
    """Objective of a name in `OBJECTIVES`, or a custom one, `package.module:name`.

    A custom one is an `Objective`, or a function that returns the score of a valid `TrialResult`.
    Raises InputError for an unknown name.
    """
    check_type(name, str, "objective", f"{', '.join(OBJECTIVES)}, or package.module:name")
    if name in OBJECTIVES:
        return OBJECTIVES[name]
    allowed = "an Objective or a function of a TrialResult"
    return as_objective(load_custom(name, "objective", known=OBJECTIVES, allowed=allowed)[0], name)


def as_objective(measure: object, name: str = "") -> Objective:
    """Objective from a name, an `Objective` or a function of a `TrialResult`.

    The label of a function is the first line of its docstring; it may have attributes `unit`, `label`,
    `needs_course`, `needs_torques` and `hold`. `name` overrides the `module:function` in sessions. Raises
    InputError for anything else.
    """
    if isinstance(measure, str):
        return make_objective(measure)
    if isinstance(measure, Objective):
        return replace(measure, name=name) if name else measure
    if isinstance(measure, type) or not callable(measure):
        raise InputError(
            f"{argument('objective')}: got {measure!r}{f' as {name}' if name else ''}; "
            "allowed: a name, an Objective, or a function of a TrialResult"
        )
    name = name or f"{measure.__module__}:{getattr(measure, '__qualname__', type(measure).__qualname__)}"
    documented = (getattr(measure, "__doc__", None) or "").strip().partition("\n")[0].rstrip(".")
    return Objective(
        name=name,
        label=str(getattr(measure, "label", documented or name)),
        unit=str(getattr(measure, "unit", "")),
        needs_course=bool(getattr(measure, "needs_course", True)),
        needs_torques=bool(getattr(measure, "needs_torques", False)),
        hold=str(getattr(measure, "hold", "none")),
        measure=measure,
    )


def undominated(scores: FloatArray) -> BoolArray:
    """Pareto front of scores (trials, objectives): trials that no other one dominates, (trials,)."""
    beaten = [bool(((scores <= row).all(axis=1) & (scores < row).any(axis=1)).any()) for row in scores]
    return ~np.array(beaten, dtype=bool)
