"""Measurements of an operator become a result, and what was not measured stays unknown."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from hexctl.adapt.measurement import Answer, measured, not_walked
from hexctl.adapt.objectives import INVALID_SCORE, OBJECTIVES
from hexctl.adapt.optimizer import Observation
from hexctl.adapt.prior.samples import DISTANCE, FINAL, features_of
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import TrialResult
from hexctl.gait.gait import make_gait
from hexctl.robot.failure import Failure
from tests.adapt.walking import result_of
from tests.robots import shipped

ROBOT = shipped()
PLAN = TrialPlan(gait=make_gait(ROBOT, "demo"), belief=Failure(leg=5))

#: As a robot that knows no pose ends its walk.
WALKED = replace(
    result_of(0.0), distance_m=None, deviation=None, yaw_change_rad=None, path_m=np.zeros((0, 2))
)


def told(word: str, distance_m: float = math.nan, signed_m: float = math.nan) -> TrialResult:
    answer = Answer(word=word, distance_m=distance_m, signed_m=signed_m)  # type: ignore[arg-type]
    return measured(WALKED, answer, ROBOT, PLAN)


def test_two_numbers_make_a_trial() -> None:
    result = told("measured", 4.0, -0.12)
    assert (result.status, result.valid, result.distance_m) == ("ok", True, 4.0)
    assert result.deviation is not None
    assert (result.deviation.final, result.deviation.signed) == (0.12, -0.12)
    assert OBJECTIVES["final"](result) == 0.12
    assert OBJECTIVES["progress"](result) == pytest.approx(0.12 * result.ideal_distance_m / 4.0)
    assert result.to_dict()["deviation_m"] == {"final": 0.12, "signed": -0.12, "mean": None, "max": None}
    json.dumps(result.to_dict(), allow_nan=False)


def test_only_the_end_is_learned_from() -> None:
    features = features_of(Observation.of(told("measured", 4.0, -0.12)), 30.0)
    assert (features[FINAL], features[DISTANCE]) == (-0.12, 4.0)
    assert np.isfinite(features).sum() == 2


@pytest.mark.parametrize(
    ("result", "status", "stopped"),
    [
        (told("measured", 1.0, 0.0), "no_progress", None),
        (told("fell"), "fell", None),
        (told("skip"), "cut_short", "skipped"),
    ],
)
def test_what_counts_for_nothing(result: TrialResult, status: str, stopped: str | None) -> None:
    assert (result.status, result.stopped, result.valid) == (status, stopped, False)
    assert OBJECTIVES["final"](result) == INVALID_SCORE
    features_of(Observation.of(result), 30.0)


@pytest.mark.parametrize("result", [told("quit"), not_walked(ROBOT, PLAN)])
def test_what_is_not_kept(result: TrialResult) -> None:
    assert (result.status, result.stopped) == ("aborted", "requested")
