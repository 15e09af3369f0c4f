"""The gait space, its distance, and the objectives: named ones and custom functions."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from hexctl.adapt.objectives import (
    INVALID_SCORE,
    OBJECTIVES,
    WORST_VALID_SCORE,
    as_objective,
    make_objective,
    undominated,
)
from hexctl.adapt.space import GaitSpace
from hexctl.control.trial_result import TrialResult
from hexctl.errors import InputError
from hexctl.gait.encoding import Slots
from hexctl.testing.optimizer_conformance import ONE_FAILED, THREE_FAILED, TWO_FAILED
from tests.adapt.walking import result_of


def order_of_legs(slots: Slots) -> tuple[int, ...]:
    """The legs in the order of their slots, around from leg 1: what walks, without its start."""
    legs = sorted(range(1, 7), key=lambda leg: slots[leg - 1])
    start = legs.index(1)
    return tuple(legs[start:] + legs[:start])


@pytest.mark.parametrize(("count", "size"), [(1, 120), (2, 24), (3, 6)])
def test_no_gait_is_under_two_codes_not_even_shifted(count: int, size: int) -> None:
    for failed in itertools.combinations(range(1, 7), count):
        space = GaitSpace(failed)
        assert space.size == size
        assert len({order_of_legs(space.slots_of(code)) for code in range(1, size + 1)}) == size


@pytest.mark.parametrize("failed", [(), (0,), (7,), (5, 2), (2, 2), (1, 2, 3, 4)])
def test_other_failed_legs_are_refused(failed: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="failed legs"):
        GaitSpace(failed)


def slow_phase(one: Slots, other: Slots) -> float:
    apart = []
    for first, second in itertools.combinations(range(6), 2):
        lag = (one[first] - one[second]) / 6 - (other[first] - other[second]) / 6
        apart.append(abs(lag - round(lag)))
    return sum(apart) / len(apart)


@pytest.mark.parametrize("space", [ONE_FAILED, TWO_FAILED, THREE_FAILED], ids=lambda space: space.size)
def test_the_phase_distance_against_the_slow_way(space: GaitSpace) -> None:
    gaits = [space.slots_of(code) for code in range(1, space.size + 1)]
    expected = [[slow_phase(one, other) for other in gaits] for one in gaits[:30]]
    np.testing.assert_allclose(space.phase_distance[:30], expected, atol=1e-12)


WALKED = replace(result_of(-0.2), energy_j=8.0, cost_of_transport=0.7, tilt_deg=0.4, steadiness=0.02)


def yaw(result: TrialResult) -> float:
    """Heading lost during the walk.

    In radians.
    """
    return abs(result.yaw_change_rad or 0.0)


yaw.unit = "rad"  # type: ignore[attr-defined]


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


@pytest.mark.parametrize("score", [math.nan, math.inf, None, "far"])
def test_a_score_that_is_not_a_finite_number_is_refused(score: object) -> None:
    objective = as_objective(lambda _: score, "mine")
    with pytest.raises(InputError, match=r"objective mine: got the score .*; allowed: a finite number"):
        objective(WALKED)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("haste", f"got 'haste'; allowed: {', '.join(OBJECTIVES)}, package.module:name"),
        (f"{__name__}:nothing", "cannot be loaded"),
        ("no_such_module_here:score", "cannot be loaded"),
        ("hexctl.adapt.space:GaitSpace", "allowed: a name, an Objective, or a function of a TrialResult"),
        ("math:pi", "allowed: a name, an Objective, or a function of a TrialResult"),
    ],
)
def test_what_is_no_objective_is_refused(name: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        make_objective(name)


@pytest.mark.parametrize(
    ("name", "score", "hold"),
    [
        ("final", 0.2, "none"),
        ("mean", 0.1, "none"),
        ("max", 0.2, "none"),
        ("progress", 0.2 * 4.455 / 4.0, "none"),
        ("speed", 30.0 / 4.0, "auto"),
        ("cost", 0.7, "auto"),
        ("tilt", 0.4, "auto"),
        ("steadiness", 0.02, "auto"),
    ],
)
def test_each_objective_scores_its_own_part_of_a_walk(name: str, score: float, hold: str) -> None:
    objective = make_objective(name)
    assert objective is OBJECTIVES[name]
    assert objective(WALKED) == pytest.approx(score)
    assert objective.hold == hold
