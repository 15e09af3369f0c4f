"""Rivals of the recovery benchmark: searches among shapes of gaits by trials, and the learned policy."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.build_archive import cell_of
from hexctl.control.batch import SimTrial
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import InputError
from hexctl.gait.gait import make_gait
from hexctl.learning.learned_walk import OBSERVATION_SIZE
from hexctl.learning.policy import policy_file, policy_of
from hexctl.robot.failure_grammar import parse_failure_event
from hexctl.robot.loader import load_robot
from hexctl.study.recovery import evolution, shaped_walk
from hexctl.study.recovery.evolution import EvolutionSearch
from hexctl.study.recovery.shaped_walk import FELL, scores_of, search_shapes, shape_of, trial_of
from hexctl.study.recovery.trial_and_error import (
    KIND,
    Behaviours,
    TrialAndErrorSearch,
    behaviours_file,
    behaviours_of,
)
from hexctl.types import FloatArray

ANT = load_robot("ant")

PLAN = TrialPlan(gait=make_gait(ANT, "tripod"), duration_s=12.0, self_rotation="none", hold="line")


def archive(count: int = 40) -> Behaviours:
    """Behaviours whose first number of the shape is their place."""
    random = np.random.default_rng(1)
    shapes = np.zeros((count, 6, 4))
    shapes[:, 0, 0] = np.arange(count) / count
    return Behaviours(
        shapes=shapes, duties=random.uniform(size=(count, 6)), speeds=np.linspace(1.0, 0.5, count),
        robot_fingerprint="ant", origin={"evaluations": 7},
    )  # fmt: skip


def told(search: TrialAndErrorSearch, score: float) -> FloatArray:
    (shape,) = search.ask()
    search.tell(np.array([score]))
    return shape


def test_trial_and_error_ends_with_a_gait_that_walks_as_in_the_archive() -> None:
    search = TrialAndErrorSearch(archive())
    assert told(search, 0.95)[0, 0] == 0, "the fastest comes first"
    assert not search.ask()


def test_trial_and_error_leaves_the_neighbourhood_of_a_gait_that_failed() -> None:
    known = archive()
    near = replace(known, duties=np.where(np.arange(40)[:, np.newaxis] < 20, 0.2, known.duties + 1))
    search = TrialAndErrorSearch(near)
    told(search, FELL)
    assert told(search, 0.1)[0, 0] >= 0.5, "the first twenty behave alike"


def test_trial_and_error_gives_up() -> None:
    search = TrialAndErrorSearch(archive())
    tried = [told(search, 0.0) for _ in range(20)]
    assert len(tried) == 20
    assert not search.ask()


def test_an_archive_turns_with_the_direction_of_travel() -> None:
    known = archive()
    turned = known.towards(np.radians(-115))
    np.testing.assert_array_equal(turned.shapes[:, 4], known.shapes[:, 0])
    np.testing.assert_array_equal(turned.duties[:, 4], known.duties[:, 0])


def test_a_file_keeps_an_archive(tmp_path: Path) -> None:
    archive().save(tmp_path / "some.npz")
    found = KIND.load(tmp_path / "some.npz", Behaviours.of)
    assert (found.robot_fingerprint, found.origin) == ("ant", {"evaluations": 7})
    np.testing.assert_allclose(found.duties, archive().duties, atol=1e-3)
    np.testing.assert_allclose(found.shapes, archive().shapes, atol=1e-3)


def test_cells_are_quarters() -> None:
    assert cell_of(np.array([0.0, 0.12, 0.13, 0.5, 0.9, 1.0])) == (0, 0, 1, 2, 4, 4)


def test_evolution_finds_the_top_of_a_hill() -> None:
    search = EvolutionSearch(np.full((6, 4), 0.5), seed=2)
    heights: list[float] = []
    while shapes := search.ask():
        scores = np.array([-float(np.abs(shape - 0.7).sum()) for shape in shapes])
        search.tell(scores)
        heights.append(float(scores.max()))
    assert len(heights) == 3, "forty trials are three generations of thirteen"
    assert heights[-1] > heights[0]


@pytest.mark.slow
def test_the_shape_of_a_gait_walks_like_the_gait_and_a_search_keeps_its_best(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(evolution, "MOST_TRIALS", 13)
    monkeypatch.setattr(shaped_walk, "TRIAL_S", 2.5)
    events = (parse_failure_event("2:limp@5"),)
    trial = SimTrial(robot=ANT, plan=PLAN, failure=None, events=events)
    whole = replace(trial, events=())
    tripod, still = shape_of(PLAN.gait), np.zeros((6, 4))
    walked, stood = scores_of([(trial_of(whole), tripod), (trial_of(whole), still)])
    assert walked > 0.5
    assert abs(stood) < 0.1
    found, nothing = search_shapes(lambda _: EvolutionSearch(tripod, seed=0), [trial, whole])
    assert found is not None
    assert nothing is None
    first = EvolutionSearch(tripod, seed=0).ask()
    scores = scores_of([(trial_of(trial), shape) for shape in first])
    assert found.trials == 13
    np.testing.assert_array_equal(found.best, first[int(np.argmax(scores))])


def test_what_is_shipped_for_ant_is_small_and_says_how_it_was_made() -> None:
    behaviours, policy = behaviours_of(ANT), policy_of(ANT)
    assert behaviours.origin["evaluations"] > len(behaviours.speeds) > 100
    assert len({cell_of(duties) for duties in behaviours.duties}) > 0.9 * len(behaviours.speeds), "rounded"
    assert policy.origin["steps"] > 10_000
    assert np.isfinite(policy(np.zeros(OBSERVATION_SIZE))).all()
    for file in (behaviours_file(ANT), policy_file(ANT)):
        assert file.stat().st_size < 200_000, file.name


@pytest.mark.parametrize("shipped", [policy_of, behaviours_of])
def test_robots_that_nothing_was_learned_for_are_refused(shipped: object) -> None:
    with pytest.raises(InputError, match="pexod"):
        shipped(load_robot("pexod"))  # type: ignore[operator]
