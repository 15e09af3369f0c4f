"""Objectives: scores of trials, by name and from a function of one's own."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hexctl.adapt.objectives import (
    INVALID_SCORE,
    OBJECTIVES,
    WORST_VALID_SCORE,
    Objective,
    as_objective,
    make_objective,
    undominated,
)
from hexctl.control.trial_result import TrialResult
from hexctl.errors import InputError
from tests.adapt.walking import result_of

WALKED = replace(result_of(-0.2), energy_j=8.0, cost_of_transport=0.7, tilt_deg=0.4, steadiness=0.02)


def yaw(result: TrialResult) -> float:
    """Heading lost during the walk.

    In radians.
    """
    return abs(result.yaw_change_rad or 0.0)


yaw.unit = "rad"  # type: ignore[attr-defined]

PRESENTED = Objective(name="other", label="a label", unit="deg", measure=lambda _: 3.0)


def test_each_has_a_name_a_label_and_a_unit() -> None:
    for name, objective in OBJECTIVES.items():
        assert objective.name == name
        assert objective.label
        assert objective.unit or name == "cost"
        assert make_objective(name) is objective


@pytest.mark.parametrize(
    ("name", "score"), [("final", 0.2), ("mean", 0.1), ("max", 0.2), ("progress", 0.2 * 4.455 / 4.0)]
)
def test_scores_are_of_the_deviation(name: str, score: float) -> None:
    assert OBJECTIVES[name](WALKED) == pytest.approx(score)


@pytest.mark.parametrize(
    ("name", "score"), [("speed", 30.0 / 4.0), ("cost", 0.7), ("tilt", 0.4), ("steadiness", 0.02)]
)
def test_steered_walks_are_scored_by_how_they_walk(name: str, score: float) -> None:
    assert OBJECTIVES[name](WALKED) == pytest.approx(score)
    assert (OBJECTIVES[name].hold, OBJECTIVES["final"].hold) == ("auto", "none")


@pytest.mark.parametrize(
    ("name", "lacks"), [("cost", "torques"), ("tilt", "orient"), ("steadiness", "posit")]
)
def test_what_was_not_measured_is_named(name: str, lacks: str) -> None:
    with pytest.raises(InputError, match=f"got a walk without .*{lacks}"):
        OBJECTIVES[name](result_of(-0.2))


def test_the_pareto_front_is_what_nothing_beats() -> None:
    scores = np.array([[1.0, 3.0], [2.0, 2.0], [2.0, 2.5], [3.0, 1.0], [1.0, 3.0], [4.0, 1.0]])
    assert undominated(scores).tolist() == [True, True, False, True, True, False]
    assert undominated(np.zeros((0, 2))).tolist() == []


@pytest.mark.parametrize("name", [*OBJECTIVES, f"{__name__}:yaw"])
@pytest.mark.parametrize("status", ["fell", "no_progress", "aborted", "diverged", "cut_short"])
def test_an_invalid_trial_is_behind_every_valid_one(name: str, status: str) -> None:
    objective = make_objective(name)
    assert objective(replace(WALKED, status=status)) == INVALID_SCORE
    assert objective(replace(WALKED, distance_m=1e-30)) <= WORST_VALID_SCORE < INVALID_SCORE


def test_a_function_is_an_objective_by_its_path() -> None:
    objective = make_objective(f"{__name__}:yaw")
    assert (objective.name, objective.label, objective.unit) == (
        f"{__name__}:yaw",
        "Heading lost during the walk",
        "rad",
    )
    assert objective(WALKED) == pytest.approx(0.1)


def test_an_object_is_an_objective_by_its_path_too() -> None:
    objective = make_objective(f"{__name__}:PRESENTED")
    assert (objective.name, objective.label, objective.unit) == (f"{__name__}:PRESENTED", "a label", "deg")


@pytest.mark.parametrize("score", [math.nan, math.inf, None, "far"])
def test_a_score_that_is_not_a_finite_number_is_refused(score: object) -> None:
    objective = as_objective(lambda _: score, "mine")
    with pytest.raises(InputError, match=r"objective mine: got the score .*; allowed: a finite number"):
        objective(WALKED)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("haste", f"got 'haste'; allowed: {', '.join(OBJECTIVES)}, or package.module:name"),
        (f"{__name__}:nothing", "cannot be loaded"),
        ("no_such_module_here:score", "cannot be loaded"),
        ("hexctl.adapt.space:GaitSpace", "allowed: a name, an Objective, or a function of a TrialResult"),
        ("math:pi", "allowed: a name, an Objective, or a function of a TrialResult"),
    ],
)
def test_what_is_no_objective_is_refused(name: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        make_objective(name)
